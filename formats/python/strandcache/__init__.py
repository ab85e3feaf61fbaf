"""Strandbake's caches in Python: `Cache` reads them, `to_usd` writes USD, `blender` brings them into Blender.

    with strandcache.Cache("shot.h5") as cache:
        for frame in cache:
            print(frame.number, frame.strands[0][-1])  # where the tip of the first strand is

The package is an add-on of Blender, too.
"""

from .cache import Cache, CacheError, Frame, Provenance, Region, Stats, Strands
from .usd import to_usd

__version__ = "0.1.0"
__all__ = ["Cache", "CacheError", "Frame", "Provenance", "Region", "Stats", "Strands", "to_usd"]

# Blender reads this without running it.
bl_info = {
    "name": "Strand cache",
    "description": "Plays hair from caches of Strandbake",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "File > Import > Strand cache",
    "category": "Import-Export",
}


def register() -> None:
    from . import blender

    blender.register()


def unregister() -> None:
    from . import blender

    blender.unregister()
