"""The text of a model, golden."""

from textwrap import dedent

from tests.support.plants import actuator


def lines(block: str) -> str:
    return dedent(block).strip("\n")


def test_a_model_prints_its_equations_and_parameters() -> None:
    expected = lines("""
        actuator: coil and flexure
          position  [m/s]  dx/dt = v
                                   velocity
          force     [N]    M dv/dt = Kf i - B v     - K x
                                     coil   damping   spring
          voltage   [V]    La di/dt = u      - Ra i       - Kv v
                                      supply   resistance   back_emf
          inputs           u [V]
          outputs          x [m] = x,  i [A] = i
          parameters
            M   0.01    kg     fixed  [0.0001, 1]  weighed
            B   0.2691  N*s/m  free   [0, inf]
            K   5895.5  N/m    free   [10, 1e6]
            Kf  1.3932  N/A    free
            Kv  1.3932  V*s/m  free
            Ra  8       ohm    free
            La  0.0005  H      free                data sheet
    """)
    assert str(actuator()) == expected
    assert str(actuator()) == expected
