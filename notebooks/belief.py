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
# # The belief: is the filter right?
#
# A robot that acts on probabilities needs probabilities that mean what they say. Four checks, small
# here and full-sized in the tests: the filter against exact enumeration, ranks of the truth in
# worlds drawn from the filter's own prior, calibration while the robot acts on its belief, and what
# happens when everything goes wrong.

# %%
# %matplotlib inline
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from studies import provoked
from studies.episode_evidence import figure_posterior, remember
from studies.own_worlds import judge_own_worlds

import jaxlangnav
from jaxlangnav.experiments import calibration
from jaxlangnav.experiments.reliability import bin_sums, reliability_curve
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.tasks import SENTENCES, Cell, ground_sentences, make_tasks
from jaxlangnav.messages import Observation
from jaxlangnav.navigator import default_params
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.viz import style
from jaxlangnav.viz.rows import reliability_figure

jaxlangnav.keep_compiled_programs()
mpl.rcParams.update(style.rc())
BLUE, ORANGE = style.SERIES[0], style.SERIES[1]
sentences = ground_sentences(list(SENTENCES.values()))
params = default_params()

# %% [markdown]
# ## What do the words refer to? Sampled and enumerated
#
# The robot has looked once and seen a cone and two hydrants, one of them half behind the cone.
# There may be others. The filter draws what *the hydrant* is, particle by particle; enumeration
# sums over every seen object and every cell of the area. 64 runs of 64 particles: the points are
# their means, the bars two standard errors.

# %%
AREA, POSE = jnp.array([0.0, 13.0, -9.2, 9.2]), jnp.zeros(3)
SEEN = {
    "cone": (1, 2.0, 0.4),
    "hydrant half behind": (0, 3.6, 2.3),
    "hydrant aside": (0, 1.5, -3.4),
}
kinds, xs, ys = (np.array(column) for column in zip(*SEEN.values(), strict=True))
slots = 8


def pad(values, fill):
    return jnp.asarray(np.pad(values, (0, slots - len(values)), constant_values=fill))


look = Observation(
    pose=POSE,
    detection_type=pad(kinds, -1),
    detection_range=pad(np.hypot(xs, ys).astype(np.float32), 0),
    detection_bearing=pad(np.arctan2(ys, xs).astype(np.float32), 0),
    is_detection=jnp.arange(slots) < len(SEEN),
    sensor=jaxlangnav.default_sensor(5.0),
)
RUNS = 64


@jax.jit
def filtered(readings):
    """Probability of each slot to be the hydrant in each run, and the belief of one of them."""
    start = semantic_filter.start(POSE, AREA, readings.mention_type.shape[1], config=MapConfig())
    run = jax.vmap(lambda key: semantic_filter.step(key, start, readings, look, params=params.map))
    beliefs, _ = run(jax.random.split(jax.random.key(0), RUNS))
    weight, particles = jnp.exp(beliefs.log_weight), beliefs.particles
    mention = readings.figure[particles.reading, 0]
    referent = jnp.take_along_axis(particles.referent, mention[:, None, :], axis=1)
    is_slot = referent == jnp.arange(slots)[None, :, None]
    share = jnp.sum(jnp.where(is_slot, weight[:, None, :], 0.0), axis=2)
    return share, jax.tree.map(lambda leaf: leaf[0], beliefs)


names = list(SEEN)[1:]
figure = Figure(figsize=(8.4, 2.8), layout="constrained")
for index, (axes, (name, text)) in enumerate(
    zip(figure.subplots(1, 3, sharey=True), SENTENCES.items(), strict=True)
):
    readings = jax.tree.map(lambda leaf, index=index: leaf[index], sentences.instructions.readings)
    share, belief = filtered(readings)
    told = remember(belief, readings, blocks=1)
    exact, unseen = jax.jit(figure_posterior)(told, params=params.map)
    order = [int(np.argmin(np.abs(np.asarray(belief.particles.mean_x[:slots, 0]) - x) + np.where(
        np.asarray(belief.particles.object_type[:, 0]) == 0, 0, 99))) for x in xs[1:]]  # fmt: skip
    exact = [*np.asarray(exact)[order], float(unseen.sum())]
    runs = np.asarray(share)[:, order]
    runs = np.column_stack([runs, 1 - runs.sum(1)])
    axes.bar(range(3), exact, color=style.UNSEEN, edgecolor=style.MUTED, label="enumeration")
    axes.errorbar(range(3), runs.mean(0), 2 * runs.std(0) / np.sqrt(RUNS), fmt="o", color=BLUE,
                  capsize=3, markersize=5, label="filter")  # fmt: skip
    axes.set_xticks(range(3), ["half behind\nthe cone", "aside", "not seen\nyet"])
    axes.set_title(text, fontsize=8)
    pulls = (runs.mean(0) - exact) / (runs.std(0) / np.sqrt(RUNS) + 1e-3)
    print(f"{name:>8}: differences of {np.round(pulls, 1)} standard errors")
figure.axes[0].set_ylabel("probability")
figure.axes[0].legend(loc="upper left")
figure

# %% [markdown]
# ## Worlds from the filter's own prior, and a robot that acts on its belief
#
# Landmark anywhere, figure where the relation has it, further objects at random, and one speaker
# in twenty misleads: in such worlds nothing is mistaken but the filter's own arithmetic. At every
# decision the belief is held against the truth. *Left*, how much of the density is likelier than
# the true place: uniform, if the filter is right. *Right*, how often the region that claims 90 %
# holds it, decision by decision. Bars are two standard errors, episode by episode; where the
# robot stops depends on what it has seen, which biases nothing.

# %%
EPISODES = 192
tally = judge_own_worlds(
    sentences, {"behind": 3.0}, policy="informed", episodes=EPISODES, seed=1, max_steps=30
)["behind"]
scores = calibration.scores(tally)
steps = np.asarray(tally.steps).sum()
rank = np.asarray(tally.rank).sum(1)
share = rank.sum(0) / steps
residual = rank - share * np.asarray(tally.steps).sum(1, keepdims=True)
error = np.sqrt((residual**2).sum(0)) / steps

figure = Figure(figsize=(8.4, 2.8), layout="constrained")
left, right = figure.subplots(1, 2)
left.bar(np.arange(10) / 10 + 0.05, share, width=0.09, yerr=2 * error, capsize=2, color=BLUE,
         ecolor=style.INK, alpha=0.85)  # fmt: skip
left.axhline(0.1, color=style.MUTED, linestyle=":")
left.set(xlabel="rank of the true place", ylabel="share of decisions", xlim=(0, 1))
stages = [calibration.scores(tally, stage) for stage in range(len(calibration.STAGES) - 1)]
right.errorbar(
    calibration.STAGES[:-1], [one["coverage90"] for one in stages],
    [2 * one["coverage90_se"] for one in stages], fmt="o-", color=BLUE, capsize=3,
)  # fmt: skip
right.axhspan(87, 93, color=style.UNSEEN, zorder=0)
right.set(xlabel="from decision", ylabel="coverage of the 90 % region, %", ylim=(75, 100))
figure

# %%
curves = {
    "the planner's probability": reliability_curve(bin_sums(tally)["planner"]),
    "the map's": reliability_curve(bin_sums(tally)["map"]),
}
print(
    f"expected calibration error {scores['ece']:.3f} (so few episodes of a perfect belief would "
    f"show {scores['ece_floor']:.3f}), Brier score {scores['brier']:.3f}, coverage "
    f"{scores['coverage90']:.1f} ± {2 * scores['coverage90_se']:.1f} %, "
    f"NLL {scores['nll']:.2f} nats"
)
reliability_figure({"": curves}, title='"This object is the goal"')

# %% [markdown]
# ## No silent death
#
# Each fault lasts from decision 2 to 5 of every episode (the weights die once). It is counted, and
# the episode goes on, or ends with a reason: squares are degenerate weights or numbers, triangles
# looks that contradict the map, diamonds detections without a slot; a dot at the end is a stop at
# the goal, a cross one elsewhere or a time-out. Lost weights and broken numbers are recovered from;
# false objects are not, for the robot takes detections never to be false.

# %%
tasks = make_tasks(Cell(world="1H1C", relation="behind", instruction_index=1, seed=3), 16)
figure = Figure(figsize=(8.4, 2.6), layout="constrained")
for fault, axes in enumerate(figure.subplots(1, len(provoked.FAULTS), sharey=True)):
    found = provoked.run_provoked(
        jnp.int32(fault), tasks, sentences.instructions,
        params=params, config=navigator_config("informed"),
    )  # fmt: skip
    status, last = np.asarray(found.statuses), np.asarray(found.result.steps)
    for episode in range(len(last)):
        axes.plot([0, last[episode] - 1], [episode] * 2, color=style.LINE, linewidth=1)
        end = "o" if found.result.is_success[episode] else "x"
        axes.plot(last[episode] - 1, episode, end, color=style.INK, markersize=3.5)
    for bit, color, mark in ((4, ORANGE, "^"), (1 + 8, style.BAD, "s"), (2, BLUE, "D")):
        where = np.argwhere(status & bit)
        axes.plot(where[:, 1], where[:, 0], mark, color=color, markersize=3.5)
    axes.set_title(provoked.FAULTS[fault], fontsize=8)
    axes.set_xlabel("decision")
    counts = [int(((status & bit) > 0).sum()) for bit in (1 + 8, 4, 2)]
    print(
        f"{provoked.FAULTS[fault]:>22}: {counts[0]} decisions degenerate, {counts[1]} astray, "
        f"{counts[2]} overfull; {int(found.result.is_stopped.sum())} of {len(last)} stopped by "
        f"themselves, {int(found.result.is_success.sum())} at the goal, all finite: "
        f"{bool(found.is_sound.all())}"
    )
figure.axes[0].set_ylabel("episode")
figure
