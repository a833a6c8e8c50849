r"""# A sheared layer through the Python interface

This demo builds the layer of `layer_medium_rough.toml` by hand: a granular layer, 4 cm high and infinitely wide,
between a very rough bottom and a medium rough top wall that moves along x1 while it carries a constant pressure. It
goes from the equations to the code; `python demos/layer_from_python.py` runs it.

## The equations

A Cosserat continuum has a displacement u and an independent rotation w of its grains. Strain and curvature are

    eps_ij = u_i,j + e_kij w_k,        kappa_ij = w_i,j,

and what resists them are a stress that need not be symmetric and a couple stress. Equilibrium, as virtual work on the
reference mesh with F = I + grad u and J = det F, asks for all v and q that

    integral [ sigma : (grad v F^-1 + E(q)) + mu : (grad q F^-1) ] J dX = work of the tractions.

In an infinite layer everything depends on x2 alone: u1(x2), u2(x2), w3(x2). One dimension is enough, linear elements
with one integration point each. The stresses follow the rate form of the hypoplastic law, integrated over each step at
that point.

## The code
"""

from cosserat_fx import geometry
from cosserat_fx.conditions import Prescribed, fixed, traction
from cosserat_fx.forms.walls import rolling_rotation
from cosserat_fx.material import Material
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import StepControl, Stepper

# The sand of the source paper; any of its ten constants may be replaced by name. SI units throughout.
sand = Material.named("paper-sand", d50=0.5e-3)
pressure = 100e3
layer = geometry.layer(height=0.04, cells=80)

# The bottom holds its grains: u = 0 and w = 0. At the top the grains are dragged along by u1 and roll by
# w = -(f_r/f_u) u1 / (d50/2); u2 is free under the pressure. Tension is positive, so the traction points down.
# Conditions are functions of the travel along the loading path, here the top's displacement.
rolling = 0.0125
conditions = [
    *fixed("bottom", "u1", "u2", "w"),
    Prescribed("top", "u1", lambda travel: travel),
    Prescribed("top", "w", lambda travel: rolling_rotation(travel, rolling / (sand.d50 / 2), outward=+1)),
    traction("top", lambda travel: (0.0, -pressure)),
]

# The problem puts forms, fields and conditions together; the solver finds equilibrium; the stepper chooses the steps.
problem = Problem(layer, sand, conditions, stress=-pressure, void_ratio=0.6)
solver = NewtonSolver(problem)
stepper = Stepper(problem, solver, corners=[0.0, 0.03], stations=[0.01, 0.02], control=StepControl(first=1e-4))

# Each step that is handed out is in equilibrium and committed. The wall's reaction is the shear stress.
for step in stepper:
    shear_stress = problem.reactions()["top", "u1"]
    height_change = problem.boundary_mean("top", "u2")
    if layer.mesh.comm.rank == 0:
        print(
            f"step {step.number:2d}: u1 = {1e3 * step.travel:7.4f} mm, s12 = {1e-3 * shear_stress:6.3f} kPa, "
            f"height {1e3 * height_change:+.4f} mm, {step.iterations} iterations"
        )
