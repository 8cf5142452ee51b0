# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough tetrahedralize`: fills a surface mesh with tetrahedra."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from followthrough.npz_files import require_output_folder, write_npz
from followthrough.surface_files import read_obj


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "tetrahedralize",
        help="fill a surface mesh with tetrahedra",
        description="Fill a surface mesh with tetrahedra and embed its vertices. The result holds the arrays "
        "vertices (n,3), tets (m,4), embedding_tets (v,) and embedding_weights (v,4).",
    )
    parser.add_argument(
        "surface", metavar="IN.obj", type=Path, help="surface mesh; it may be open, broken or of many parts"
    )
    parser.add_argument("-o", "--output", metavar="OUT.npz", type=Path, required=True, help="where to write the result")
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--cells", metavar="N", type=int, default=25, help="cells along the longest side (default %(default)s)"
    )
    size.add_argument("--cell-size", metavar="S", type=float, help="edge of a cell, in the mesh's units")
    parser.add_argument(
        "--split-parts", action="store_true", help="do not glue parts of the body that merely come near each other"
    )
    parser.add_argument(
        "--method",
        choices=("voxel", "tetgen"),
        default="voxel",
        help="voxel (default) takes any surface; tetgen fills a closed one exactly and needs the tetgen extra",
    )


def run(args: argparse.Namespace) -> int:
    """Do it."""
    from followthrough import mesh

    require_output_folder(args.output)
    vertices, triangles = read_obj(args.surface)
    volume = mesh.tetrahedralize(
        vertices,
        triangles,
        cells=args.cells,
        cell_size=args.cell_size,
        split_parts=args.split_parts,
        method=args.method,
    )
    write_npz(
        args.output,
        {
            "vertices": volume.vertices,
            "tets": volume.tets,
            "embedding_tets": volume.embedding_tets,
            "embedding_weights": volume.embedding_weights,
        },
    )
    cells = f"{volume.cells} cells of {volume.cell_size:g}, " if args.method == "voxel" else ""
    print(
        f"{args.output}: {cells}{len(volume.vertices)} vertices, {len(volume.tets)} tets, {volume.parts} "
        f"{'part' if volume.parts == 1 else 'parts'}; {len(vertices)} surface vertices embedded"
    )
    return 0
