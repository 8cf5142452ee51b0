# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets to learn secondary motion from: sequences whose `dynamic` is the converged simulation, made from a seed.

`spheres` is the published training data [DE 3.3]; `varied` is more of it, with `shapes` that are moved by `gestures`.
`held_out` is for measuring: `characters` that dance a `choreography`, of which nothing is trained on.

A recipe (`recipes`) says what the sequences of a data set are; `generation` simulates them, in several processes, into a folder
with a manifest (`manifest`).
"""

from followthrough.datasets.generation import Summary, generate
from followthrough.datasets.held_out import HeldOutRecipe
from followthrough.datasets.manifest import Manifest
from followthrough.datasets.recipes import Item, Recipe
from followthrough.datasets.spheres import SphereRecipe
from followthrough.datasets.varied import ShapesRecipe

__all__ = ["HeldOutRecipe", "Item", "Manifest", "Recipe", "ShapesRecipe", "SphereRecipe", "Summary", "generate"]
