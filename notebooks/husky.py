# ---
# jupyter:
#   jupytext:
#     formats: py:percent,ipynb
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]

# %% [markdown]
# # A Husky: wheels, a camera, tags
#
# Until here the robot was a point with a sensor. This one has wheels that slip in MuJoCo and a
# camera that renders; tags are found in its pictures, and the navigator knows odometry and tags
# and nothing else. It is simulation, not a physical experiment. It needs
# `pip install "jaxlangnav[robot]"` and EGL: [docs/robot.md](../docs/robot.md).

# %%
# %matplotlib inline
import io

import jax
import matplotlib.pyplot as plt
import numpy as np

from jaxlangnav import keep_compiled_programs
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.robots.libraries import check_libraries
from jaxlangnav.robots.recorded import record_drive
from jaxlangnav.robots.table3 import TABLE3, make_robot, navigator_of
from jaxlangnav.viz.panels import belief_figure

check_libraries()  # says in one line what to install
keep_compiled_programs()
row = next(one for one in TABLE3 if one.robot == "husky")
text = SENTENCES[row.relation]
robot, navigator = make_robot(row, seed=0, trial=0), navigator_of(row.robot)
noise = float(navigator.params.map.motion.odometry_noise)
view = np.rad2deg(float(robot.sensor.field_of_view))
print(f'"{text}"')
print(f"sees {row.range:g} m far, {view:.0f}° wide;", end=" ")
print(f"each cycle's odometry is taken to be out by {100 * noise:.0f} % of its way")

# %% [markdown]
# That share is measured, not chosen: a skid-steer slides aside whenever it turns
# (`python scripts/measure_odometry.py`). The wheelchair's is 2.2 %.
#
# ## From a sentence to an ending

# %%
ended, recording = record_drive(robot, text, navigator=navigator, key=jax.random.key(0))
result = recording.result
print(f"{ended.ending.value}: {robot.travelled:.1f} m in {robot.seconds:.0f} s,", end=" ")
print(f"{len(ended.steps)} looks, {float(result.goal_distance):.1f} m from the hydrant meant")

# %% [markdown]
# ## Four moments
#
# Above from outside, below through its camera. Tags framed in green are told to the navigator;
# orange ones are too far off, too far aside or seen too aslant: restrictions as the paper's.

# %%
moments = np.unique(np.linspace(0, recording.num_steps - 1, 4).round().astype(int))
figure, axes = plt.subplots(2, len(moments), figsize=(3.2 * len(moments), 5.2), squeeze=False)
for column, step in zip(axes.T, moments, strict=True):
    for axis, jpeg in zip(column, recording.pictures[step].values(), strict=True):
        axis.imshow(plt.imread(io.BytesIO(jpeg), format="jpg"))
        axis.set_axis_off()
    column[0].set_title(f"step {step} · {recording.frames.distance[step]:.1f} m")
figure.tight_layout()

# %% [markdown]
# ## What it believes meanwhile
#
# The same picture as of any episode: a drive's recording is an episode's.

# %%
belief_figure(recording, num_panels=3)

# %% [markdown]
# ## Where it is, where its wheels have it, and where it believes itself
#
# Dead reckoning drifts. Things seen again pull the belief, things and robot together; what counts
# for the ending is where the robot stands to the goal, and that the camera sees.

# %%
frames, place = recording.frames, recording.scene.scenario
figure, axis = plt.subplots(figsize=(6.4, 4.2))
for name, way, style in (
    ("truly", frames.position, "k-"),
    ("by wheels and gyro", frames.odometry, "C1--"),
    ("believed", frames.robot, "C0-"),
):
    axis.plot(*way.T, style, label=name)
axis.plot(
    place.object_x[place.is_object],
    place.object_y[place.is_object],
    "s",
    color="0.6",
    label="things",
)
axis.plot(*place.goal, "r*", markersize=13, label="the hydrant meant")
axis.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
axis.legend(loc="best", fontsize=8)
off = np.hypot(*(frames.odometry[-1] - frames.position[-1]))
print(f"at the end odometry is out by {100 * off:.0f} cm after {robot.travelled:.1f} m")

# %% [markdown]
# ## When something goes wrong
#
# The camera stops after four seconds. Nothing is said to have been reached that was not seen.

# %%
robot.close()
robot = make_robot(row, seed=0, trial=0)
robot.at(4.0, lambda one: setattr(one, "camera_works", False))
ended, _ = record_drive(robot, text, navigator=navigator, key=jax.random.key(0))
robot.close()
print(f"{ended.ending.value}: {ended.why}")

# %% [markdown]
# `viz.html.write_html(recording, "husky.html")` writes the drive as a page with a slider: both
# views, map, story and numbers of every step. `python scripts/film_robot.py husky.gif` films it,
# `jaxlangnav reproduce table3` repeats the paper's trials of both robots.
