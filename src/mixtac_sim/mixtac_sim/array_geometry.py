# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Size of the DAVIS346 array, and how the simulator keeps it in memory.

Pixels are numbered row by row. Arrays over pixels are padded to whole tiles of 64 neighbours in
memory; a tile is what is skipped when nothing in it changes.
"""

WIDTH = 346
"""Columns (user guide)."""
HEIGHT = 260
"""Rows (user guide)."""
PITCH_MM = 0.0185
"""Pixel pitch [mm] (user guide)."""
PIXELS = WIDTH * HEIGHT
"""Pixels of the array."""
TILE = 64
"""Pixels of a tile."""
TILES = -(-PIXELS // TILE)
"""Tiles of the array."""
PADDED = TILES * TILE
"""Length of arrays over pixels."""
