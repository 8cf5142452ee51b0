# SPDX-License-Identifier: GPL-3.0-or-later
"""Times and errors of every solver side by side: `followthrough benchmark` as a library.

`scene` makes what is measured, `methods` lists what is, `measurement` measures, `report` and `plot` show it.
"""
