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

# Six base stations outside a room of 20 m. Up to two of six links are shut at a time, and then 4 to 20 m too long.
world = sn.simulation.HandsetWorld.generate(seed=3, max_blocked=2)
half = 10.0
common = {"start_m": world.start_m, "start_sigma_m": 5.0}
locator = sn.navigation.HandsetLocator(
    world.nodes_m,
    particles=1000,
    seed=1,
    start_heading_rad=world.told_heading_rad,  # within 10 degrees
    start_heading_sigma_rad=math.radians(6.0),
    room_m=half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
    **common,
)
steps = (world.frame_s, world.increments)
told = np.square([1e-3, 1e-3, math.radians(0.02)])  # five times what the steps are off, and their heading's drift
run = locator.run(*steps, world.epoch_s, world.ranges_m, sigma_m=1.0, track_covariance=told)
alone = sn.navigation.HandsetLocator.lte_alone(world.nodes_m, **common)
other = alone.run([], np.zeros((0, 3)), world.epoch_s, world.ranges_m, sigma_m=1.0)

settled = world.epoch_s > 20.0  # clock and excess delays are known by then
rms_m = [float(np.sqrt(np.mean(one.error_m(world.position_m)[settled] ** 2))) for one in (run, other)]
right = np.mean((run.p_los > 0.5)[settled] != world.nlos.blocked[settled])
print(locator)
print(f"LTE and camera {rms_m[0]:.2f} m RMS, LTE alone {rms_m[1]:.2f} m; sight judged right {100 * right:.0f} %")
assert rms_m[0] < 1.5
assert rms_m[1] > 2.0 * rms_m[0]
assert right > 0.8
