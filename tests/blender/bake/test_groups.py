# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted groups are read as they are painted, and made where they are missing."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import (
    MASS_GROUP,
    PINS_GROUP,
    STIFFNESS_GROUP,
    Bake,
    ObjectSettings,
    PaintGroups,
    PinGroup,
    add_groups,
    groups,
    read_paint,
    read_surface,
    write_group,
)
from followthrough.settings import Settings, VolumeSettings
from followthrough.suggestions import suggest_paint


def test_missing_groups_are_added_with_suggestions(character):
    values = np.linspace(0.0, 1.0, len(character.mesh.data.vertices))
    write_group(character.mesh, MASS_GROUP, values)
    active = character.mesh.vertex_groups.active_index
    assert add_groups(character.mesh) == [STIFFNESS_GROUP, PINS_GROUP]
    assert add_groups(character.mesh) == []
    assert character.mesh.vertex_groups.active_index == active
    surface = read_surface(character.mesh)
    paint, suggested = read_paint(character.mesh, surface), suggest_paint(surface)
    assert paint.mass == pytest.approx(values, abs=1e-6)
    assert paint.stiffness == pytest.approx(suggested.stiffness, abs=1e-6)
    assert paint.pins == pytest.approx(suggested.pins, abs=1e-6)


def test_without_groups_suggestions_are_read(character):
    surface = read_surface(character.mesh)
    paint, suggested = read_paint(character.mesh, surface), suggest_paint(surface)
    for name in ("stiffness", "mass", "pins"):
        assert np.array_equal(getattr(paint, name), getattr(suggested, name))
    assert not any(group.name.startswith("Followthrough") for group in character.mesh.vertex_groups)


def test_suggestions_know_the_bones_of_a_sampled_mesh_too(character):
    surface = read_surface(character.mesh)
    suggested = suggest_paint(surface)
    character.mesh.modifiers.new("Smooth", "SMOOTH")
    sampled = read_surface(character.mesh)
    assert sampled.rig is None
    assert np.array_equal(read_paint(character.mesh, sampled).stiffness, suggested.stiffness)


def test_an_empty_group_pins_nothing(character):
    character.mesh.vertex_groups.new(name=PINS_GROUP)
    assert not read_paint(character.mesh, read_surface(character.mesh)).pins.any()


def test_named_groups_are_read(character):
    count = len(character.mesh.data.vertices)
    write_group(character.mesh, "Soft", np.full(count, 0.25))
    write_group(character.mesh, "Heavy", np.full(count, 0.75))
    for name, value in (("Hat", 0.9), ("Belt", 0.5)):
        write_group(character.mesh, name, np.full(count, value))
    groups = PaintGroups(stiffness="Soft", mass="Heavy", pins=(PinGroup("Hat", 0.5), PinGroup("Belt", 1.0)))
    paint = read_paint(character.mesh, read_surface(character.mesh), groups)
    assert paint.stiffness == pytest.approx(np.full(count, 0.25))
    assert paint.mass == pytest.approx(np.full(count, 0.75))
    assert paint.pins == pytest.approx(np.full(count, 0.5))


@pytest.mark.parametrize(
    "groups", [PaintGroups(stiffness="No"), PaintGroups(mass="No"), PaintGroups(pins=(PinGroup("No"),))]
)
def test_a_named_group_that_is_missing_is_refused(character, groups):
    with pytest.raises(ValueError, match=r"no vertex group 'No' \(it has 'Lower', 'Upper'\)"):
        read_paint(character.mesh, read_surface(character.mesh), groups)


def test_groups_can_be_added_from_edit_mode(character):
    bpy.context.view_layer.objects.active = character.mesh
    bpy.ops.object.mode_set(mode="EDIT")
    assert len(add_groups(character.mesh)) == 3
    assert character.mesh.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert read_paint(character.mesh, read_surface(character.mesh)).mass == pytest.approx(0.5)


@pytest.mark.parametrize("cells", [VolumeSettings().cells, 9])
def test_suggestions_for_a_bake_take_its_tets_where_those_are_the_usual_ones(character, monkeypatch, cells):
    suggested = suggest_paint(read_surface(character.mesh))
    found = []

    def suggest(surface, tets):
        found.append((suggest_paint(surface, tets), tets))
        return found[-1][0]

    monkeypatch.setattr(groups, "suggest_paint", suggest)
    settings = Settings(solver="springs", volume=VolumeSettings(cells=cells))
    bake = Bake(bpy.context.scene, {character.mesh_name: ObjectSettings(motion=settings)})
    bake.cancel()
    ((paint, tets),) = found
    assert (tets is not None) == (cells != 9)
    for name in ("stiffness", "mass", "pins"):
        np.testing.assert_array_equal(getattr(paint, name), getattr(suggested, name))
