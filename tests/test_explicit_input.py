# SPDX-License-Identifier: MIT
"""Explicit steps: bad input is refused, and the message says where it is and what to do."""

import re

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, UnstableError, formulations, points
from fenicsmpm.formulations import Kinematics
from fenicsmpm.materials import Hencky, VonMises
from fenicsmpm.points.point_field import PointField

COMM = MPI.COMM_WORLD
LAW = Hencky(E=100.0, nu=0.3)
CELLS = {"lattice": mesh.CellType.quadrilateral, "triangles": mesh.CellType.triangle}
both_ways = pytest.mark.parametrize("kind", CELLS)


def start(kind="lattice", velocity=None):
    """A block in the middle of the unit square, its unknown and its internal force."""
    domain = mesh.create_unit_square(COMM, 6, 6, CELLS[kind])
    body = points.lattice(domain, 1 / 12, inside=lambda x: np.abs(x[:2] - 0.5).max(axis=0) < 0.25)
    formulations.set_initial_state(body, 2.0, velocity)
    z = formulations.Unknown(domain, "v")
    return body, z, formulations.internal_force(z.test.v, body, LAW)


@pytest.mark.once
@pytest.mark.parametrize("material", [None, "hencky", object(), Hencky])
def test_materials_that_are_no_law(material):
    body, z, _ = start()
    with pytest.raises(TypeError, match=r"a material is a law such as materials\.Hencky.* not "):
        formulations.internal_force(z.test.v, body, material)


@pytest.mark.once
def test_data_that_is_no_function():
    body, z, R = start()
    with pytest.raises(TypeError, match=r"data must be a function of the times .* not 'x'"):
        ExplicitMPM(R, z, body, data="x")


@pytest.mark.mpi
@both_ways
def test_numbers_that_are_not_finite(kind):
    """Found on the rank that has them, and raised on all; before and after the loop is made."""
    body, z, R = start(kind)
    for name, value, options in (("v", np.nan, {}), ("mass", np.inf, {"dt": 1e-4})):
        message = rf"the field '{name}' must be .*finite, but is .*{value}.* at point 20"
        sim = ExplicitMPM(R, z, body, **options)
        before = body[name].copy()
        body[name][body.id == 20] = value
        with pytest.raises(ValueError, match=message):
            sim.step()
        with pytest.raises(ValueError, match=message):
            ExplicitMPM(R, z, body, **options)
        body[name] = before


@pytest.mark.once
def test_positions_that_are_not_finite():
    body, _, _ = start()
    x = body.x.copy()
    x[3] = np.nan
    with pytest.raises(ValueError, match=r"positions must be finite: .* point 3"):
        body.move(x)
    with pytest.raises(ValueError, match="positions are changed by move"):
        body["x"] = x


@pytest.mark.once
def test_masses_that_are_not_positive():
    body, z, R = start()
    body["mass"][3] = 0.0
    with pytest.raises(ValueError, match="the field 'mass' must be positive and finite, but is 0"):
        ExplicitMPM(R, z, body)


@both_ways
def test_a_velocity_is_no_increment(kind):
    body, z, R = start(kind)
    k = Kinematics(z.v, body)
    for expression in (k.j, k.F[0, 0], k.J):
        with pytest.raises(ValueError, match="Kinematics needs an increment of displacement"):
            ExplicitMPM(R + expression * z.test.v[0] * body.dx, z, body)
    body.add_field("J_own")
    with pytest.raises(ValueError, match="Kinematics needs an increment of displacement"):
        ExplicitMPM(R, z, body, updates={body: {"J_own": k.J}})
    dt = 1e-3
    rate = ufl.tr(ufl.grad(z.v)) + Kinematics(dt * z.v, body).j
    ExplicitMPM(R + rate * z.test.v[0] * body.dx, z, body).step()


@pytest.mark.mpi
@both_ways
def test_points_that_stay(kind, said):
    body, z, R = start(kind)
    lost = body.select(lambda x: x[0] < 0.4)
    size = lost.size_global
    load = formulations.dead_load(z.test.v, lost, (0.0, 1.0))
    ExplicitMPM(R + load, z, body)
    wanted = f"{size} points of an integral are neither bodies nor carried"
    assert len([line for line in said if line.startswith(wanted)]) == 1
    said.clear()
    ExplicitMPM(R + load, z, body, carried=[lost])
    assert not any("neither bodies nor carried" in line for line in said)


@both_ways
def test_fields_that_are_renewed_twice(kind):
    body, z, R = start(kind)
    body.add_field("T", (), 1.0)
    T = body.field("T")
    R += 1e-9 * T * z.test.v[0] * body.dx
    twice = r"the field 'T' is renewed twice"
    T.renew(T + 1)
    T.renew(T + 2)
    with pytest.raises(ValueError, match=twice):
        ExplicitMPM(R, z, body)
    # a second object for the same field
    T.renew(T + 1)
    PointField(body, "T").renew(lambda k: k.j * T)
    with pytest.raises(ValueError, match=twice):
        ExplicitMPM(R, z, body)
    T.renew(T + 1)
    with pytest.raises(ValueError, match=twice):
        ExplicitMPM(R, z, body, updates={body: {"T": T + 3}})
    with pytest.raises(ValueError, match="the field 'sigma' is renewed twice"):
        ExplicitMPM(R, z, body, updates={body: {"sigma": body.field("F")}})
    # the same twice, and another simulation that renews it in another way
    for _ in range(2):
        T.renew(lambda k: 2 * k.j * T)
    ExplicitMPM(R, z, body).step()
    assert body["T"] == pytest.approx(2.0)
    T.renew(3 * T)
    ExplicitMPM(R, z, body).step()
    assert body["T"] == pytest.approx(6.0)


@pytest.mark.once
def test_the_state_of_a_law_is_renewed_by_it():
    body, z, _ = start()
    R = formulations.internal_force(z.test.v, body, VonMises(E=100.0, nu=0.3, sigma_y=1.0))
    with pytest.raises(ValueError, match="the field 'eps_p' is renewed twice"):
        ExplicitMPM(R, z, body, updates={body: {"eps_p": 2 * body.field("eps_p")}})


@both_ways
def test_what_an_unstable_step_says(kind):
    """Number and time of the step, the point and where it is, the stable step, and a hint."""
    body, z, R = start(kind, lambda x: np.sin(20 * x[:2]))
    sim = ExplicitMPM(R, z, body, dt=1.0)
    stable = sim.stable_step()
    with pytest.raises(UnstableError) as error:
        sim.step()
    number = r"-?[\d.]+(e[+-]\d+)?"
    point = rf"point \d+ (is inverted|leaves the lattice) at \[ *{number} +{number} *\]"
    assert re.fullmatch(
        rf"step 1, t = 1 s, dt = 1 s: {point} with J = {number}; the stable step is about "
        f"{stable:g} s; the step is longer than that: take smaller ones",
        str(error.value),
    )
    assert (sim.number, sim.time) == (0, 0.0)


@pytest.mark.ranks
@pytest.mark.mpi
@pytest.mark.parametrize("kind", CELLS)
@pytest.mark.parametrize("cells", [1, 2])
def test_more_ranks_than_cells_with_material(kind, cells):
    """A body in one or two cells falls freely, also on ranks without points."""
    domain = mesh.create_unit_square(COMM, 6, 6, CELLS[kind])
    right = (2 + cells) / 6
    inside = lambda x: (x[0] > 2 / 6) & (x[0] < right) & (x[1] > 2 / 6) & (x[1] < 3 / 6)  # noqa: E731
    body = points.lattice(domain, 1 / 12, inside=inside)
    assert body.size_global == 4 * cells
    formulations.set_initial_state(body, 2.0, (0.2, 0.0))
    z = formulations.Unknown(domain, "v")
    R = formulations.internal_force(z.test.v, body, LAW)
    R += formulations.body_force(z.test.v, body, (0.0, -1.0))
    sim = ExplicitMPM(R, z, body, dt=1e-3)
    for _ in sim.run(0.1, 0.05):
        pass
    assert np.allclose(body["v"], [0.2, -0.1], atol=1e-10)
    assert body.size_global == 4 * cells
