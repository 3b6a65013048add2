"""Directional albedos of moomill's and of Cycles' reflecting lobes, by which rebuild.py brings the two together. Integrated here on
their own, from the formulas: nothing of moomill's tables is read.
"""
import math

import numpy

METAL_IOR = 1.65  # of the dielectric's curve that lies nearest to Schlick's from above


def lobe_tables():
    """What scales Cycles' GGX lobes to moomill's, by the cosine to the eye and by roughness: [65, 64, 5], rows are roughness
    0..1, columns the square root of the cosine 0..1. Es, Ed: directional albedo of moomill's lobe, whose Smith masking is correlated
    by height, without Fresnel and at IOR 1.5. Then, over the same integral with Cycles' masking (the two terms multiplied): Es, Ed, and
    that of Schlick's (1 - cos)^5 over the curve of METAL_IOR. Sums over visible normals (Heitz 2018), weight F G2 / G1."""
    columns, rows = 64, 65
    x = numpy.linspace(0, 1, columns)
    co = numpy.maximum(x * x, 1e-4)[:, None, None]
    # Finer towards the end of the radius, where the tail of GGX decides what falls under the horizon.
    q = 1 - (numpy.arange(64) + 0.5) / 64
    r = numpy.sqrt(1 - q ** 3)[None, :, None]
    weight = (q ** 2)[None, :, None] * numpy.ones((1, 1, 24))
    weight = weight / weight.sum()
    phi = (2 * math.pi * (numpy.arange(24) + 0.5) / 24)[None, None, :]
    table = numpy.zeros((rows, columns, 5), dtype=numpy.float32)
    for j in range(rows):
        alpha = max((j / (rows - 1)) ** 2, 1e-3)
        so = numpy.sqrt(1 - co * co)
        vx, vz = alpha * so, co
        length = numpy.sqrt(vx * vx + vz * vz)
        vx, vz = vx / length, vz / length
        # Basis around the stretched view direction (vx, 0, vz): (0, 1, 0) and (-vz, 0, vx).
        p1, s = r * numpy.cos(phi), 0.5 * (1 + vz)
        p2 = (1 - s) * numpy.sqrt(numpy.maximum(0, 1 - p1 * p1)) + s * r * numpy.sin(phi)
        p3 = numpy.sqrt(numpy.maximum(0, 1 - p1 * p1 - p2 * p2))
        h = numpy.stack(numpy.broadcast_arrays(alpha * (-p2 * vz + p3 * vx), alpha * p1, numpy.maximum(1e-7, p2 * vx + p3 * vz)))
        h /= numpy.sqrt((h * h).sum(axis=0))
        oh = so * h[0] + co * h[2]
        ci = 2 * oh * h[2] - co

        def smith(c):
            c2 = numpy.maximum(c * c, 1e-14)
            return 0.5 * (numpy.sqrt(1 + alpha * alpha * numpy.maximum(0, 1 - c2) / c2) - 1)

        c = numpy.clip(oh, 0, 1)

        def fresnel(ior):
            g = numpy.sqrt(ior ** 2 - 1 + c * c)
            return 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)

        least = ((METAL_IOR - 1) / (METAL_IOR + 1)) ** 2
        curve = (fresnel(METAL_IOR) - least) / (1 - least)
        above = (ci > 0) & (oh > 0)
        ours = numpy.where(above, (1 + smith(co)) / (1 + smith(co) + smith(ci)), 0) * weight
        theirs = numpy.where(above, 1 / (1 + smith(ci)), 0) * weight

        def total(values):
            return values.sum(axis=(1, 2))

        def ratio(a, b):  # 0 / 0 for the curves of a mirror seen head on
            return numpy.clip(a / numpy.maximum(b, 1e-9), 0, 2)

        es, ed, schlick = total(ours), total(ours * fresnel(1.5)), total(ours * (1 - c) ** 5)
        table[j] = numpy.stack([es, ed, ratio(es, total(theirs)), ratio(ed, total(theirs * fresnel(1.5))), ratio(schlick, total(theirs * curve))], axis=1)
    return table
