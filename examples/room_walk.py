"""A handset indoors: LTE ranges that are shut at times, and a camera that looks at the floor.

A second of the walk is rendered and followed; for the whole minute ranges and steps are drawn with their errors.

python examples/room_walk.py
"""

import math

import numpy as np

import soopnav_cpp as sn

# A camera 1.1 m above a textured floor, leaning by a few degrees, moves by 20 mm a frame; a depth sensor beside it.
if sn.vision.available():
    camera = sn.vision.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    floor = sn.simulation.GroundScene(seed=1)
    ego = sn.vision.EgoMotion(camera)
    view = {"height_m": 1.1, "tilt_rad": (math.radians(6.0), math.radians(-4.0))}
    way = [(0.02 * k, 0.1 * math.sin(0.1 * k), 0.01 * k) for k in range(21)]
    errors_m = []
    for k, pose in enumerate(way):
        image = floor.render(camera, pose, **view, noise=2.0, frame=k)
        points = floor.depth_cloud(camera, pose, **view, points=10_000, frame=k)
        motion = ego.step(image, points=points, t_s=0.05 * k)
        if motion.ok:
            errors_m.append((motion.increment - floor.increment(way[k - 1], pose))[:2])
    print(motion)
    print(f"steps of 20 mm: errors of {1e3 * np.sqrt(np.mean(np.square(errors_m))):.3f} mm RMS")
    assert len(errors_m) == 20
    assert np.abs(errors_m).max() < 2e-3
