"""How an experiment becomes arrays: one layout for all models of the same signals."""

import gc
import weakref
from dataclasses import replace

import numpy as np

import greybox as gb
from greybox.simulation.records import to_record
from models.micro_actuator import micro_actuator


def experiment():
    time = 1e-3 * np.arange(50)
    return gb.Experiment.from_arrays(time, {"u": np.sin(time)}, {"x": time**2}, name="one")


def test_models_of_the_same_records_share_one_layout():
    record = experiment()
    laid_out = to_record(micro_actuator, record)
    assert to_record(micro_actuator + gb.effect("coulomb_friction"), record) is laid_out
    # The same numbers in another experiment, and another way to hold the input, are laid out anew.
    assert to_record(micro_actuator, experiment()) is not laid_out
    assert to_record(micro_actuator, replace(record, hold="first")) is not laid_out


def test_an_effect_that_holds_the_input_otherwise_has_a_layout_of_its_own():
    record = experiment()
    held = replace(gb.effect("linear_input"), hold="band-limited")
    assert to_record(micro_actuator + held, record).rows_per_sample > 1
    assert to_record(micro_actuator, record).rows_per_sample == 1


def test_a_layout_is_kept_no_longer_than_it_is_used():
    record = experiment()
    laid_out = weakref.ref(to_record(micro_actuator, record))
    gc.collect()
    assert laid_out() is None
