# SPDX-License-Identifier: MIT
"""Laws of one's own without a tangent in implicit loops, and the check of a tangent."""

import math

import numpy as np
import pytest
from energy_bodies import block, simulation, total_energy

from fenicsmpm import materials
from fenicsmpm.formulations import EnergyMomentum, Newmark, Response, Unknown
from fenicsmpm.materials import Hencky, Law, VonMises, check_tangent, compiled

HENCKY, PLASTIC = Hencky(100.0, 0.3), VonMises(100.0, 0.3, sigma_y=4.0, H=5.0)


def stripped(law, *parts):
    """The same law with its update and some other functions."""
    functions = {name: getattr(law, name) for name in parts}
    return Law(
        law.update, law.parameters, law.wave_speed_modulus, law.state, needs_rate=False, **functions
    )


@compiled
def ogden(F, L, parameters, state, sigma):
    """As somebody would write it: numpy, no care for speed; counts steps."""
    J = np.linalg.det(F)
    if J <= 0:
        sigma[:, :] = np.nan
        return
    w, n = np.linalg.eigh(F @ F.T)
    for i in range(3):
        for j in range(3):
            sigma[i, j] = 0.0
            for a in range(3):
                principal = parameters[0] * math.log(w[a]) + parameters[1] * math.log(J)
                sigma[i, j] += principal * n[i, a] * n[j, a] / J
    state[0] += 1.0


@pytest.mark.parametrize("law", [HENCKY, PLASTIC], ids=["Hencky", "VonMises"])
def test_steps_without_a_tangent(law):
    """The same as with the consistent tangent, in as many iterations."""
    ends, iterations = [], []
    for given in (law, stripped(law)):
        body = block()
        sim = simulation(body, given, Newmark)
        iterations.append([sim.step().newton.iterations for _ in range(3)])
        ends.append(body.snapshot())
    assert iterations[0] == iterations[1]
    for name in ("F", "x", "v"):
        assert ends[0][name] == pytest.approx(ends[1][name], rel=1e-9, abs=1e-9)
    if law is PLASTIC:
        assert ends[1]["eps_p"].max() > 0.01


def test_a_plain_function():
    """Newton's method converges as with a tangent; its state is that of steps, not of calls."""
    body = block()
    law = Law(
        ogden, [38.0, 57.0], 134.0, state={"steps": ((), 0.0)}, needs_rate=False
    )  # fmt: skip
    sim = simulation(body, law, Newmark)
    for _ in range(3):
        assert sim.step().newton.iterations <= 6
    assert np.all(body["steps"] == 3)
    assert np.abs(np.linalg.det(body["F"]) - 1).max() > 0.01


def test_energy_is_kept_without_a_tangent():
    """An energy is all that the energy-momentum stress needs."""
    body = block()
    sim = simulation(body, stripped(PLASTIC, "energy"))
    energy = total_energy(body)
    for _ in range(4):
        sim.step()
    assert body["eps_p"].max() > 0.01
    assert total_energy(body) == pytest.approx(energy, rel=1e-11)


def test_no_energy_no_work():
    body = block()
    response = Response(stripped(HENCKY), body, body.field("F"))
    with pytest.raises(ValueError, match="need a law with an energy: Law"):
        response.work
    with pytest.raises(ValueError, match="need a law with an energy: Law"):
        EnergyMomentum(stripped(HENCKY), body, Unknown(body.mesh, "u"))
    assert "S" not in body


# --- the check --------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [HENCKY, PLASTIC, VonMises(1.0, 0.3, 0.1, sigma_r=0.05, eta=0.5)])
def test_right_tangents(law):
    assert check_tangent(law) < 1e-6
    F = np.eye(3)[None] + 0.05 * np.random.default_rng(1).standard_normal((20, 3, 3))
    state = law.initial_state(20)
    materials.stress(law, F, state=state)
    before = state.copy()
    assert check_tangent(law, F @ F, state) < 1e-6
    assert check_tangent(law, F) < 1e-6
    assert np.all(state == before)


@compiled
def _elastic_tangent(F, parameters, state, dPdF):
    """Of small strains: wrong at any rotation."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    shear = parameters[0] * ((i == k) * (j == m) + (i == m) * (j == k))
                    lame = parameters[1] - 2 / 3 * parameters[0]
                    dPdF[i, j, k, m] = shear + lame * (i == j) * (k == m)


@compiled
def _no_tangent(F, parameters, state, dPdF):
    dPdF[:, :, :, :] = np.nan


def test_wrong_tangents():
    law = stripped(HENCKY, "energy")
    law.tangent = _elastic_tangent
    assert check_tangent(law, np.eye(3)[None]) < 1e-9
    with pytest.raises(ValueError, match=r"not the derivative .* at point \d+, dP\[") as e:
        check_tangent(law)
    assert "1.0e-06 allowed. F = [[" in str(e.value)
    assert check_tangent(law, rtol=10.0) > 0.1
    law.tangent = _no_tangent
    with pytest.raises(ValueError, match="relative error nan"):
        check_tangent(law)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"law": stripped(HENCKY)}, "no tangent"),
        ({"law": HENCKY, "F": np.eye(3)}, r"shape \(n, 3, 3\)"),
        ({"law": HENCKY, "F": np.empty((0, 3, 3))}, "no deformation gradients"),
        ({"law": HENCKY, "rtol": 0.0}, "rtol = 0.0"),
        ({"law": PLASTIC, "state": PLASTIC.initial_state(1)}, "without deformation gradients"),
        ({"law": PLASTIC, "F": np.eye(3)[None], "state": np.zeros((2, 11))}, "float64 of shape"),
    ],
)
def test_what_cannot_be_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        check_tangent(**arguments)
