"""Codes of what an exported model has to say about itself."""

from __future__ import annotations

from enum import StrEnum


class ExportFinding(StrEnum):
    """Findings about an exported model; their sentences are in `greybox.show.sentences.linear`."""

    FIT_FAILED = "exported_fit_failed"
    """The fit behind the model did not succeed."""
    NO_EQUILIBRIUM = "export_no_equilibrium"
    """The operating point is given in full and is no equilibrium."""
    STEADY_MOTION = "export_steady_motion"
    """A position moves at a constant rate at the operating point."""
    OUTSIDE_RECORDS = "export_outside_records"
    """The operating point lies far outside the estimation records."""
    FRICTION_LEFT_OUT = "export_friction_left_out"
    """Dry friction at standstill is not in the matrices."""
    KINK = "export_kink"
    """The derivative differs by side; one side was used."""
    PLAY_CLOSED = "export_play_closed"
    """Play is taken as closed."""
    INPUT_WITHOUT_EFFECT = "export_input_without_effect"
    """An input has no effect at the operating point."""
    DELAY_APPROXIMATED = "export_delay_approximated"
    """A delay became a Pade approximation."""
    STATES_REMOVED = "export_states_removed"
    """A minimal realisation has fewer states."""
    MODE_UNDERSAMPLED = "export_mode_undersampled"
    """The sampling time is too long for an oscillating mode."""
    DECAY_UNDERSAMPLED = "export_decay_undersampled"
    """Every mode decays within one sample."""
    TUSTIN_RINGS = "export_tustin_rings"
    """The trapezoidal rule turns a fast real pole into an alternating one."""
    PARAMETERS_NOT_DRAWN = "export_parameters_not_drawn"
    """Parameters without a covariance keep their fitted value in a family of models."""
