# SPDX-License-Identifier: GPL-3.0-or-later
"""Physically believable secondary motion for skinned characters.

The way through the library, once a character and then once a frame::

    surface mesh + armature --(once)--> Volume: voxel tets, embedding, bone weights, painted stiffness, mass and pins
    bone matrices --> reference positions --> Solver.step --> dynamic positions --> inverse skinning --> shape key offsets

See `docs/architecture.md`.
"""

from followthrough._core import __version__

__all__ = ["__version__"]
