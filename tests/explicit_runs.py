# SPDX-License-Identifier: MIT
"""Explicit simulations for tests: bodies with laws, gravity and loads on one space."""

from dolfinx import fem

from fenicsmpm import ExplicitMPM, basis, formulations


def use(points, name):
    """Choose grid functions; for uGIMP, points are squares or cubes."""
    if points.grid_functions is not None or name == "linear":
        return
    if name == "gimp":
        dim = points.mesh.geometry.dim
        size = (points.volume() / max(points.size_global, 1)) ** (1 / dim)
        basis.use(points, name, half_size=size / 2)
    else:
        basis.use(points, name)


def simulate(V, laws, *, functions="quadratic", gravity=None, fbar="default", loads=(), **options):
    """A simulation of bodies by their laws, on a space or for an unknown with its conditions.

    Loads have their forces in a field "force" [N].
    """
    z = V if isinstance(V, formulations.Unknown) else formulations.Unknown(fem.Function(V), "v")
    w = z.V
    forms = []
    for body, law in laws.items():
        use(body, functions)
        forms.append(formulations.internal_force(w, body, law, fbar=fbar))
        if gravity is not None:
            forms.append(formulations.body_force(w, body, gravity))
    for load in loads:
        if load.grid_functions is None:
            body = next(iter(laws))
            size = {} if functions != "gimp" else {"half_size": body.grid_functions[1]}
            if functions != "linear":
                basis.use(load, functions, **size)
        load["weight"] = 1.0
        forms.append(formulations.dead_load(w, load, load.field("force")))
    return ExplicitMPM(sum(forms[1:], forms[0]), z, list(laws), carried=loads, **options)
