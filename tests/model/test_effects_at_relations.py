"""Effects at relations: the same as the effect at a body of its own, or typed by hand; what cannot stick there is refused."""

import subprocess
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Effect, Input, Model, Output, Parameter, State
from greybox.base.errors import MissingNameError, ModelError
from greybox.estimation.identifiability.structural import analyse_structural_identifiability
from greybox.extensions.export.c_code import to_c
from greybox.extensions.export.modelica import to_modelica
from greybox.extensions.export.python_model import to_python
from greybox.model.effects.catalogue import applicable_effects, effect
from greybox.model.effects.scales import measure_scales
from greybox.model.equations import equations_text
from greybox.shell.project import find_model
from greybox.simulation.kernel.c_compiler import find_compiler

MOTION = [Input(f"{name}{k}", unit) for k in (1, 2) for name, unit in (("q", "rad"), ("v", "rad/s"), ("a", "rad/s^2"))]
ARM = Model(
    "arm",
    states=[State("t1", "N*m"), State("t2", "N*m")],
    inputs=MOTION,
    outputs=[Output("t1", "N*m"), Output("t2", "N*m")],
    parameters=[
        Parameter("J1", "kg*m^2", 2.0, (0, 10)),
        Parameter("J2", "kg*m^2", 0.5, (0, 10)),
        Parameter("w", "N*m", 3.0),
    ],
    balances=lambda x, u, p: [
        Balance("joint_1", "N*m", 0, "t1", motor=x.t1, inertia=-p.J1 * u.a1).moving("v1", "q1"),
        Balance("joint_2", "N*m", 0, "t2", motor=x.t2, inertia=-p.J2 * u.a2, weight=-p.w * ca.sin(u.q2)).moving(
            "v2", "q2"
        ),
    ],
)
# The second joint as a body of its own, which moves by a given torque.
BODY = Model(
    "body",
    states=[State("q", "rad"), State("v", "rad/s")],
    inputs=[Input("T", "N*m")],
    outputs=[Output("q", "rad")],
    parameters=[Parameter("J2", "kg*m^2", 0.5), Parameter("w", "N*m", 3.0)],
    balances=lambda x, u, p: [
        Balance("turning", "rad/s", 1, "q", speed=x.v),
        Balance("joint_2", "N*m", p.J2, "v", motor=u.T, weight=-p.w * ca.sin(x.q)),
    ],
)
AT_JOINT = sorted(e.name for e in applicable_effects(ARM) if e.site == "joint_2")


def torques(model, *, v2, q2=1.4, a2=0.7, states=()):
    u = [0.1, 0.2, 0.3, q2, v2, a2]
    return np.array(model.system.output_function(list(states), u, list(model.values.values()))).ravel()


def rates(model, x, u):
    return np.array(model.system.rhs_function(x, u, list(model.values.values()))).ravel()


def test_each_joint_takes_what_a_body_of_its_own_takes() -> None:
    at_body = {e.name for e in applicable_effects(BODY) if e.site in ("force", "angle", "joint_2")}
    assert {name.removesuffix("_at_joint_2") for name in AT_JOINT} == at_body
    assert at_body >= {"coulomb_friction", "lugre_friction", "second_mode", "viscoelastic_creep", "gravity_torque"}


@pytest.mark.parametrize("name", [n for n in AT_JOINT if not n.startswith("load_dependent")])
@pytest.mark.parametrize("v2", [0.8, -0.3])
def test_an_effect_in_a_relation_is_the_force_that_it_is_at_a_body(name: str, v2: float) -> None:
    """``t = J a + w sin q - F`` at the relation, where ``F`` is what accelerates a body of inertia J less."""
    joint, body = ARM + effect(name), BODY + effect(name.removesuffix("_at_joint_2"))
    generator = np.random.default_rng(5)
    for own, of_body in zip(joint.bound_effects[0].parameters, body.bound_effects[0].parameters, strict=True):
        assert own.unit == of_body.unit
        value = float(generator.uniform(0.2, 0.9))
        joint, body = joint.start(**{own.name: value}), body.start(**{of_body.name: value})
    own_states = generator.uniform(-0.1, 0.3, len(joint.system.state_names))
    x = [1.4, v2, *own_states]
    force = 0.5 * (rates(body, x, [1.0])[1] - rates(BODY, x[:2], [1.0])[1])
    added = torques(joint, v2=v2, states=own_states) - torques(ARM, v2=v2)
    assert added == pytest.approx([0.0, -force], abs=1e-12) and abs(force) > 1e-6
    if len(own_states):
        u = [0.1, 0.2, 0.3, 1.4, v2, 0.7]
        assert rates(joint, own_states, u) == pytest.approx(rates(body, x, [1.0])[2:])


def test_friction_under_load_counts_what_the_joint_carries() -> None:
    model = (ARM + effect("load_dependent_friction_at_joint_2")).start(Fc=0.1, mu=0.2)
    load = 0.5 * 0.7 + 3.0 * np.sin(1.4)
    assert (torques(model, v2=0.8) - torques(ARM, v2=0.8))[1] == pytest.approx(0.1 + 0.2 * load)


def test_the_catalogue_s_effects_are_as_those_typed_by_hand() -> None:
    """One fit with effects of the catalogue at both joints, one with the same terms typed into the relations."""

    def balances(x, u, p):
        first, second = ARM.balances(x, u, p)
        return [
            first.with_term("friction", -p.F1 * ca.sign(u.v1)),
            second.with_term("drag", -p.B2 * ca.fabs(u.v2) * u.v2),
        ]

    constants = [Parameter("F1", "N*m", 0.0, (0, 10)), Parameter("B2", "N*m*s^2/rad^2", 0.0, (0, 10))]
    typed = replace(ARM, balances=balances, parameters=[*ARM.parameters, *constants])
    added = ARM + effect("coulomb_friction") + effect("quadratic_damping_at_joint_2")
    time, rng = 0.01 * np.arange(800), np.random.default_rng(1)
    angles = {k: rng.normal(size=4) @ np.sin(np.outer(np.arange(1, 5), time) + k) for k in (1, 2)}
    u = {}
    for k, q in angles.items():
        u |= {f"q{k}": q, f"v{k}": np.gradient(q, time), f"a{k}": np.gradient(np.gradient(q, time), time)}
    truth = typed.start(F1=0.4, B2=0.3)
    noise = {"t1": 0.05, "t2": 0.05}
    record = gb.simulate(truth, {"time": time, **u}).record(noise, rng)
    fits = [gb.fit(model, record, noise=noise) for model in (typed, added)]
    for one, other in (("J1", "J1"), ("J2", "J2"), ("w", "w"), ("F1", "Fc"), ("B2", "B2")):
        by_hand, by_name = fits[0].parameters[one], fits[1].parameters[other]
        assert by_name.value == pytest.approx(by_hand.value, rel=1e-6) and by_name.std == pytest.approx(
            by_hand.std, rel=1e-4
        )
        assert by_hand.interval[0] - by_hand.std < truth.values[one] < by_hand.interval[1] + by_hand.std


def test_what_a_model_of_relations_alone_determines() -> None:
    """Of ``t = J a + w sin q`` every constant shows, of an inertia beside another of the same joint the sum."""
    assert analyse_structural_identifiability(ARM).complete
    rotor = Effect(
        "rotor", "joint_2", [Parameter("Jr", "kg*m^2", 0.0)], terms=lambda x, u, p: -p.Jr * u.a2, amplitudes=("Jr",)
    )
    (direction,) = analyse_structural_identifiability(ARM + rotor).directions
    assert set(direction.names) == {"J2", "Jr"}


def test_one_input_with_the_role_of_a_velocity_needs_no_word_more() -> None:
    inputs = [Input("v", "rad/s", role="velocity"), Input("a", "rad/s^2"), Input("q", "rad", role="displacement")]
    model = Model(
        "joint",
        states=[State("T", "N*m")],
        inputs=inputs,
        outputs=[Output("T", "N*m")],
        parameters=[Parameter("J", "kg*m^2", 2.0)],
        balances=lambda x, u, p: [Balance("torque", "N*m", 0, "T", motor=x.T, inertia=-p.J * u.a)],
    )
    assert dict(model.sites[0].states) == {"velocity": "v", "displacement": "q"}
    with pytest.raises(MissingNameError, match="balance 'torque': no velocity 'w'"):
        Model(
            "wrong",
            model.states,
            inputs,
            model.outputs,
            model.parameters,
            lambda x, u, p: [model.balances(x, u, p)[0].moving("w")],
        )


def _swing(x, u, p):
    return [
        Balance("turning", "rad/s", 1, "q", speed=x.v),
        Balance("speed", "rad/s^2", 1, "v", acceleration=x.a),
        Balance("joint_2", "N*m", 0, "a", motor=u.T, weight=-p.w * ca.sin(x.q), inertia=-p.J2 * x.a),
    ]


SWING = Model("swing", [*BODY.states, State("a", "rad/s^2")], BODY.inputs, BODY.outputs, BODY.parameters, _swing)


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("coulomb_friction", {"Fc": 0.6}),
        ("stribeck_friction", {"Fc": 0.4, "Fs": 0.8, "vs": 0.1}),
        ("lugre_friction", {"Fc": 0.4, "Fs": 0.5, "s0": 200.0, "s1": 1.0}),
    ],
)
def test_a_relation_that_is_solved_for_an_acceleration_sticks_as_its_body_does(name: str, values) -> None:
    assert [s.name for s in SWING.sites if s.is_motion] == ["joint_2"]
    time = 0.005 * np.arange(800)
    push = {"time": time, "T": 1.2 * np.sin(2 * time)}
    runs = [gb.simulate((m + effect(name)).start(**values), push, initial={"q": 0.1}) for m in (BODY, SWING)]
    assert runs[1].outputs["q"] == pytest.approx(runs[0].outputs["q"], abs=1e-12)
    assert (np.diff(runs[0].outputs["q"]) == 0).any() or name == "lugre_friction"


def test_friction_that_sticks_in_a_relation_stands_in_modelica_at_the_body_that_it_holds(tmp_path) -> None:
    text = to_modelica((SWING + effect("coulomb_friction")).start(Fc=0.6), tmp_path / "swing").read_text()
    assert "level_v" in text and "sign(" not in text


def test_friction_that_cannot_hold_is_refused_with_what_helps() -> None:
    slider = Model(
        "slider",
        states=[State("x", "m"), State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("x", "m")],
        parameters=[Parameter("B", "N*s/m", 2.0)],
        balances=lambda x, u, p: [
            Balance("position", "m/s", 1, "x", speed=x.v),
            Balance("force", "N", 0, "v", drive=u.F, oil=-p.B * x.v),
        ],
    )
    with pytest.raises(
        ModelError, match=r"balance 'force' stores nothing; give it a storage, or add .* effect.smoothed"
    ):
        slider + effect("coulomb_friction")
    # 0 = F - B v - Fc tanh(v / vt), solved by Newton's method.
    rubbing = (slider + effect("coulomb_friction").smoothed(0.1)).start(Fc=0.5)
    v = 0.2
    push = 2.0 * v + 0.5 * np.tanh(v / 0.1)
    assert rates(rubbing, [0.0], [push]) == pytest.approx([v])
    # Two joints that push each other through their inertias.
    coupled = Model(
        "coupled",
        states=[State("v1", "rad/s"), State("v2", "rad/s"), State("a1", "rad/s^2"), State("a2", "rad/s^2")],
        inputs=[Input("T", "N*m")],
        outputs=[Output("v1", "rad/s")],
        parameters=[Parameter("J", "kg*m^2", 1.0), Parameter("c", "kg*m^2", 0.3)],
        balances=lambda x, u, p: [
            Balance("speed_1", "rad/s^2", 1, "v1", acceleration=x.a1),
            Balance("speed_2", "rad/s^2", 1, "v2", acceleration=x.a2),
            Balance("joint_1", "N*m", 0, "a1", motor=u.T, inertia=-p.J * x.a1 - p.c * x.a2),
            Balance("joint_2", "N*m", 0, "a2", inertia=-p.c * x.a1 - p.J * x.a2),
        ],
    )
    with pytest.raises(ModelError, match=r"through balance 'joint_2', which stores nothing, more than v2 feels"):
        coupled + effect("coulomb_friction_at_joint_2")
    smooth = (coupled + effect("coulomb_friction_at_joint_2").smoothed(0.01)).start(Fc=0.5)
    expected = np.linalg.solve([[1.0, 0.3], [0.3, 1.0]], [2.0, -0.5 * np.tanh(0.004 / 0.01)])
    assert rates(smooth, [0.0, 0.004], [2.0]) == pytest.approx(expected)


def test_smoothed_keeps_what_acts_beside_and_leaves_others_alone() -> None:
    asymmetric = (ARM + effect("asymmetric_friction_at_joint_2").smoothed(0.2)).start(Fp=1.0, Fm=0.4)
    added = (torques(asymmetric, v2=0.1) - torques(ARM, v2=0.1))[1]
    assert added == pytest.approx(0.7 * np.tanh(0.5) + 0.3)
    drag = effect("quadratic_damping")
    assert drag.smoothed(0.1) is drag


def test_scales_at_a_joint_are_those_of_its_motion() -> None:
    time = 0.01 * np.arange(700)
    u = np.column_stack(
        [
            np.sin(time),
            np.cos(time),
            -np.sin(time),
            *(3 * np.sin(2 * time), 6 * np.cos(2 * time), -12 * np.sin(2 * time)),
        ]
    )
    scales = measure_scales(ARM, np.zeros((700, 0)), u, 0.01).at("joint_2")
    assert scales.velocity == pytest.approx(6.0) and scales.displacement == pytest.approx(3.0, rel=1e-4)
    # The largest of motor, inertia and weight, here J a, over the largest acceleration.
    assert scales.force == pytest.approx(6.0, rel=1e-4) and scales.storage == pytest.approx(0.5, rel=1e-3)


def test_a_model_of_relations_alone_is_written_and_read(tmp_path) -> None:
    model = (ARM + effect("coulomb_friction") + effect("cubic_stiffness_at_joint_2")).start(Fc=0.3, K3=0.2)
    again = find_model(str(to_python(model, tmp_path / "arm.py")))
    assert torques(again, v2=0.8) == pytest.approx(torques(model, v2=0.8))
    assert equations_text(again) == equations_text(model)
    assert "0 = t1 - J1 a1 - Fc sign(v1)" in " ".join(equations_text(model).split())
    if find_compiler():
        source, _ = to_c(model, tmp_path / "arm.c", dt=0.01)
        subprocess.run(
            [*find_compiler().command, "-Wall", "-Werror", "-c", str(source), "-o", str(tmp_path / "arm.o")], check=True
        )


def test_an_effect_of_one_s_own_sees_the_motion_of_its_joint() -> None:
    drag = Effect(
        "drag",
        "joint_2",
        [Parameter("c", "{force}/{velocity}", 0.0)],
        terms=lambda x, u, p: -p.c * x.velocity,
        amplitudes=("c",),
    )
    assert (torques((ARM + drag).start(c=0.5), v2=0.8) - torques(ARM, v2=0.8)) == pytest.approx([0.0, 0.4])
