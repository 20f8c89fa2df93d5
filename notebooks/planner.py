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
# # Planner: why QMDP stops too early, and what information does about it
#
# *Go to the hydrant nearest to the cone*: there are two hydrants and one cone, and the robot sees
# only two metres far. Whichever hydrant it meets first, it cannot know whether that is the one
# until it has seen where the cone is.
#
# The paper's policy (QMDP, eq. 10 to 12; here `faithful`) values a waypoint by how near it is to
# the goal, on average over all hypotheses of the map. That is the right value if every doubt were
# gone after the next step. So it never pays for a look, and it stops as soon as enough
# *hypotheses* agree. Our `informed` policy is paid for looking, and accepts a goal only once
# everything that the sentence mentions has been seen.

# %%
# %matplotlib inline
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import jaxlangnav
from jaxlangnav.viz import mapping, style
from jaxlangnav.viz.narrative import closing
from jaxlangnav.viz.panels import values_figure
from jaxlangnav.viz.summary import distinct_nodes

jaxlangnav.keep_compiled_programs()
mpl.rcParams.update(style.rc())
TEXT = "go to the hydrant nearest to the cone"
POLICIES = {"faithful": style.SERIES[1], "informed": style.SERIES[0]}


def run(policy, seed, text=TEXT):
    """One episode; the same seed gives both policies the same world and the same noise."""
    return jaxlangnav.follow(text, world="2H1C", sensing_range=2.0, policy=policy, seed=seed)


def ending(recording):
    """How an episode ended: at the meant hydrant, at another place, or not at all."""
    result = recording.result
    if not result.is_stopped:
        return "time-out"
    return "right" if result.is_success else "wrong stop"


# %% [markdown]
# ## The same twenty-four worlds, twice

# %%
episodes = {policy: [run(policy, seed) for seed in range(24)] for policy in POLICIES}
for policy, recordings in episodes.items():
    ends = [ending(one) for one in recordings]
    metres = np.mean([float(one.result.distance) for one in recordings])
    counts = ", ".join(f"{ends.count(end)} {end}" for end in ("right", "wrong stop", "time-out"))
    print(f"{policy:>8}: {counts}; {metres:.1f} m on average")

# %%
MARKS = {"right": "o", "wrong stop": "X", "time-out": "s"}
figure = Figure(figsize=(8.4, 2.9), layout="constrained")
axes = figure.subplots()
for policy, color in POLICIES.items():
    for seed, one in enumerate(episodes[policy]):
        shift = -0.13 if policy == "faithful" else 0.13
        axes.plot(
            seed + shift, float(one.result.distance), MARKS[ending(one)], color=color, markersize=6,
            markerfacecolor=color if ending(one) == "right" else "white", markeredgewidth=1.4,
        )  # fmt: skip
known = [one.scene.known_distance for one in episodes["informed"]]
axes.plot(range(len(known)), known, "_", color=style.MUTED, markersize=13)
for policy, color in POLICIES.items():
    axes.plot([], [], "o", color=color, label=policy)
for end, mark in MARKS.items():
    face = style.INK if end == "right" else "white"
    axes.plot([], [], mark, color=style.INK, markerfacecolor=face, label=end)
axes.plot([], [], "_", color=style.MUTED, markersize=13, label="known map")
axes.set(xlabel="world (seed)", ylabel="metres walked", ylim=(0, None), xticks=range(0, 24, 2))
axes.grid(axis="y")
axes.legend(ncols=6, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)
figure

# %% [markdown]
# An empty cross is a robot that said "here it is" at the wrong hydrant. Let us look at the first
# world in which the paper's policy does so and ours does not.

# %%
seed = next(
    seed
    for seed in range(24)
    if ending(episodes["faithful"][seed]) == "wrong stop"
    and ending(episodes["informed"][seed]) == "right"
)
pair = {policy: episodes[policy][seed] for policy in POLICIES}

figure = Figure(figsize=(8.4, 5.4), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for axes, (policy, recording) in zip(panels, pair.items(), strict=True):
    last = recording.at(-1)
    mapping.draw_ground(axes, recording.scene, last)
    mapping.draw_truth(axes, recording.scene)
    mapping.draw_hypotheses(axes, last)
    mapping.draw_objects(axes, last)
    mapping.draw_path(axes, recording, recording.num_steps - 1)
    mapping.draw_robot(axes, last)
    axes.set_title(f"{policy}: {ending(recording)} after {float(last.distance):.1f} m")
    axes.set_xlabel("x (m)")
panels[0].set_ylabel("y (m)")
handles = [
    handle
    for handle in mapping.legend_handles(pair["faithful"])
    if handle.get_label() not in ("waypoint", "field of view")
]
figure.legend(handles=handles, loc="outside lower center", ncols=5)
figure

# %% [markdown]
# The dotted ring is the goal that was meant. `faithful` stands at a hydrant. The small blue
# squares around it are cones that it has never seen, but believes in: nearly every one of them
# makes this hydrant the nearest. `informed` came by the same hydrant and did not believe it.
#
# ## Belief is not evidence
#
# A robot may stop once the probability that the goal is within reach exceeds τ. What differs is
# which probability. `faithful` counts every hypothesis; `informed` counts only those in which all
# that the sentence mentions has been observed. Here are both, in the two episodes.


# %%
def within_reach(recording, kind):
    """Tell which goals lie within reach of where the robot believes to be, bool[T, ...]."""
    frames = recording.frames
    x = getattr(frames, f"{kind}_x") - frames.robot[:, :1]
    y = getattr(frames, f"{kind}_y") - frames.robot[:, 1:]
    return np.hypot(x, y) <= float(recording.scene.planner.reach)


figure = Figure(figsize=(8.4, 3.0), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for axes, (policy, recording) in zip(panels, pair.items(), strict=True):
    frames, planner = recording.frames, recording.scene.planner
    metres = frames.distance
    confirmed = np.max(frames.goal_confirmed * within_reach(recording, "goal"), axis=1)
    believed = np.sum(frames.goal_mass * within_reach(recording, "goal"), axis=1) + np.sum(
        frames.hypothesis_goal_mass * within_reach(recording, "hypothesis_goal"), axis=1
    )
    axes.plot(metres, believed, color=style.SPLIT["goal"], label="believed to be within reach")
    axes.plot(metres, confirmed, color=style.SPLIT["information"], label="… and confirmed by sight")
    axes.axhline(
        float(planner.stop_probability), color=style.INK, linewidth=0.9, linestyle="--", label="τ"
    )
    axes.set(title=policy, xlabel="metres walked", ylim=(-0.02, 1.05))
    axes.grid(axis="y")
panels[0].set_ylabel("probability")
handles = panels[0].get_legend_handles_labels()[0]
figure.legend(handles=handles, loc="outside lower center", ncols=3)
figure

# %%
for policy, recording in pair.items():
    print(policy.upper(), *closing(recording.scene, recording.at(-1), recording.result), sep="\n  ")

# %% [markdown]
# ## What a waypoint is worth
#
# The value of a waypoint has three parts: being near the **goal**, the **information** that the
# way there would bring, and a **cost**. `faithful` has the first only. The bars under each map
# split the five best waypoints.

# %%
values_figure(pair["faithful"], num_panels=3)

# %%
values_figure(pair["informed"], num_panels=3)

# %% [markdown]
# As numbers, at the step before the paper's robot says stop:

# %%
for policy, recording in pair.items():
    step = min(pair["faithful"].num_steps, recording.num_steps) - 2
    frame = recording.at(step)
    print(f"{policy}, step {step}:   place (m)     goal  information   cost   value")
    for node in distinct_nodes(frame)[:4]:
        place = f"({frame.node_x[node]:5.1f}, {frame.node_y[node]:5.1f})"
        goal, information = frame.goal_value[node], frame.information_value[node]
        cost, value = frame.cost[node], frame.value[node]
        print(f"{place:>31} {goal:8.3f} {information:12.3f} {cost:6.2f} {value:7.3f}")

# %% [markdown]
# ## Cost: places to keep away from
#
# The third part is what a sentence forbids. The same robot, told to keep clear of the cone,
# charges every waypoint to which the way would lead past it: on the left the cone has not been
# seen, on the right it has, and the pale discs are the places behind it.

# %%
told = run("informed", seed, "go to the hydrant and stay away from the cone")
cost = np.where(np.isfinite(told.frames.value), told.frames.cost, np.nan)
step = int(np.nanstd(cost, axis=1).argmax())  # where waypoints differ most in it
print(f"{ending(told)}; step {step}: {int((cost[step] > 0.5).sum())} waypoints lie past the cone")
values_figure(told, steps=[step // 2, step])

# %% [markdown]
# ## What to take away
#
# - QMDP assumes that all doubt is gone after one step. It therefore treats a belief as good as a
#   sight, and with a short view it stops at hydrants whose cone it has only imagined.
# - Valuing information costs metres where the first guess was right, and saves them, and the
#   success, where it was not. The first plot shows both kinds of worlds.
# - Both policies stand in every table of [the results](../docs/results.md); a policy of your own
#   takes twenty lines (`your_own_world`).
