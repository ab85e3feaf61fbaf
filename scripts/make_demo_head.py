#!/usr/bin/env python3
"""Writes the head of the demo scene: a skeleton that turns, nods and sways, as a glTF file without meshes.

    python3 scripts/make_demo_head.py scenes/demo_head.gltf

The same bytes come out every time. Metres, +Y up, the face looks along +Z; in rest the head stands at (0, 1.6, 0).
"""

import base64
import json
import math
import struct
import sys

KEYS_PER_SECOND = 24
SECONDS = 5.0

# Time [s] and angle [degrees]; between two of them the motion starts and ends without velocity and acceleration.
TURN = [(0.4, 0), (0.95, 60), (1.3, 60), (1.95, -60), (2.25, -60), (2.8, 40), (3.3, -15), (3.7, 0)]
NOD = [(0.4, 0), (0.7, -8), (1.3, 6), (2.0, -6), (3.4, 0), (3.75, 28), (4.05, -14), (4.35, 12), (4.7, 0)]
LEAN = [(0.3, 0), (1.0, -5), (1.9, 6), (2.7, -4), (3.5, 2), (4.4, 0)]
# Time [s] and way [m] to the side.
SWAY = [(0.2, 0), (0.95, 0.06), (1.95, -0.08), (2.8, 0.05), (3.8, 0)]


def along(points, time):
    """Minimum-jerk curve through the points, held outside."""
    if time <= points[0][0]:
        return points[0][1]
    for (t0, v0), (t1, v1) in zip(points, points[1:]):
        if time < t1:
            u = (time - t0) / (t1 - t0)
            return v0 + (v1 - v0) * u * u * u * (10 - 15 * u + 6 * u * u)
    return points[-1][1]


def about(axis, degrees):
    """Quaternion x, y, z, w of a rotation about axis 0, 1 or 2."""
    half = math.radians(degrees) / 2
    q = [0.0, 0.0, 0.0, math.cos(half)]
    q[axis] = math.sin(half)
    return q


def product(a, b):
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]


def tracks():
    times = [k / KEYS_PER_SECOND for k in range(int(SECONDS * KEYS_PER_SECOND) + 1)]
    root = [[along(SWAY, t), 0.0, 0.0] for t in times]
    spine = [about(2, along(LEAN, t)) for t in times]
    # The neck takes a third of the turn, a little ahead of the head.
    neck = [about(1, along(TURN, t + 0.04) / 3) for t in times]
    head = [product(about(1, along(TURN, t) * 2 / 3), about(0, along(NOD, t))) for t in times]
    return times, [(0, "translation", root), (1, "rotation", spine), (2, "rotation", neck), (3, "rotation", head)]


def make():
    times, moves = tracks()
    data = b""
    views, accessors, samplers, channels = [], [], [], []

    def add(values, kind):
        nonlocal data
        rows = [v if isinstance(v, list) else [v] for v in values]
        packed = b"".join(struct.pack("<%df" % len(row), *row) for row in rows)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(packed)})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(rows), "type": kind})
        data += packed
        return len(accessors) - 1

    clock = add(times, "SCALAR")
    # The format wants the range of the times, as the floats that are stored.
    accessors[clock]["min"] = [times[0]]
    accessors[clock]["max"] = [times[-1]]
    for node, path, values in moves:
        output = add(values, "VEC4" if path == "rotation" else "VEC3")
        samplers.append({"input": clock, "output": output, "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})

    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode("ascii")
    return {
        "asset": {"version": "2.0", "generator": "scripts/make_demo_head.py"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "Root", "children": [1]},
            {"name": "Spine", "translation": [0, 1.0, 0], "children": [2]},
            {"name": "Neck", "translation": [0, 0.48, 0], "children": [3]},
            {"name": "Head", "translation": [0, 0.12, 0]},
        ],
        "animations": [{"name": "Turn", "channels": channels, "samplers": samplers}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": uri}],
    }


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: make_demo_head.py FILE.gltf")
    with open(sys.argv[1], "w", encoding="ascii", newline="\n") as out:
        json.dump(make(), out, indent=1)
        out.write("\n")


if __name__ == "__main__":
    main()
