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
# # Sweep: thousands of episodes, tables, plots
#
# One episode proves nothing: worlds differ far more than policies do. A sweep runs a grid of
# worlds, commands, ranges and policies, all of them in the same worlds with the same noise, so
# that they can be compared pair by pair.
#
# The question here: there are two hydrants. What is the relation in *go to the hydrant **behind
# the cone*** worth, and how does that depend on how far the robot sees?

# %%
# %matplotlib inline
import tempfile
import tomllib
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from rich.console import Console

import jaxlangnav
from jaxlangnav.experiments.summary import render, summarize_directory
from jaxlangnav.experiments.sweep import run_sweep, total_episodes
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.viz import style
from jaxlangnav.viz.sweep import POLICY_STYLES, range_figure

jaxlangnav.keep_compiled_programs()
mpl.rcParams.update(style.rc())

GRID = """
name = "what a relation is worth"
episodes = 150                       # of each cell
worlds = ["2H1C"]
commands = ["null", "behind"]        # "go to the hydrant", "go to the hydrant behind the cone"
ranges = [2, 3, 5, 10]               # metres
policies = ["informed", "frontier", "known"]
"""
config = config_from_dict(tomllib.loads(GRID))
print(f"{total_episodes(config)} episodes")

# %% [markdown]
# `informed` is ours; `frontier` goes to the nearest edge of what it has seen, knows that it looks
# for a hydrant, and does not read the rest of the sentence; `known` has the map. On the command
# line this is `jaxlangnav sweep grid.toml --out results`.

# %%
folder = Path(tempfile.mkdtemp())
done = run_sweep(config, folder)
seconds = done["wall_s"] - done["compile_s"]
print(f"{done['episodes']} episodes in {done['wall_s']:.0f} s", end=", ")
print(f"of which {done['compile_s']:.0f} s compilation", end=": ")
print(f"{done['episodes'] / seconds:.0f} episodes a second")

# %% [markdown]
# A killed sweep goes on with `resume=True`, and `shard="2/8"` runs one part of eight. What it
# leaves is a manifest (settings, versions, hash of the models) and Parquet files with one row per
# episode.

# %%
files = sorted(folder.glob("*.parquet"))
rows = pa.concat_tables([pq.read_table(file) for file in files])
print(*(f"{file.name:>24} {file.stat().st_size / 1000:6.0f} kB" for file in files), sep="\n")
print(f"{rows.num_rows} rows; columns:", ", ".join(rows.column_names))

# %% [markdown]
# ## The table, with intervals and paired tests

# %%
document = summarize_directory(folder)
searching = document | {  # the known map is a yardstick: it stays in the picture below
    "rows": [row for row in document["rows"] if row["policy"] != "known"],
    "comparisons": [one for one in document["comparisons"] if one["second"]["policy"] != "known"],
    "varied": [name for name in document["varied"] if name != "particles"],
}
Console(width=122, force_jupyter=False, force_terminal=False).print(render(searching))

# %% [markdown]
# ## The same as a picture

# %%
range_figure(document | {"sentences": SENTENCES, "episodes": config.episodes})

# %% [markdown]
# Without the relation nobody can do better than half: either hydrant is as good. With it, reading
# the sentence to its end doubles success. It is not free where the view is short, for a hydrant
# without its cone is not accepted; the wider the view, the less there is to look for.
#
# ## Row by row
#
# Means hide what happens. Each point is one world that both policies ran, at a view of 3 m.


# %%
def column(policy, relation, name, reach=3.0):
    """One column of the rows of a policy, ordered by episode."""
    is_mine = (
        (rows["policy"].to_numpy(zero_copy_only=False) == policy)
        & (rows["relation"].to_numpy(zero_copy_only=False) == relation)
        & (rows["range"].to_numpy() == reach)
    )
    order = np.argsort(rows["episode"].to_numpy()[is_mine])
    return rows[name].to_numpy(zero_copy_only=False)[is_mine][order]


figure = Figure(figsize=(8.4, 3.9), layout="constrained")
left, right = figure.subplots(1, 2)
ours, theirs = (column(policy, "behind", "distance") for policy in ("informed", "frontier"))
is_right = column("frontier", "behind", "is_success").astype(bool)
for mask, face, name in ((is_right, style.SERIES[0], "right"), (~is_right, "white", "wrong")):
    left.plot(
        theirs[mask], ours[mask], "o", markersize=4.5, color=style.SERIES[0],
        markerfacecolor=face, label=f"frontier at the {name} hydrant",
    )  # fmt: skip
most = max(ours.max(), theirs.max()) * 1.05
left.plot([0, most], [0, most], color=style.MUTED, linewidth=0.9)
left.set(xlabel="frontier (m)", ylabel="informed (m)", xlim=(0, most), ylim=(0, most))
left.set_title("metres walked in the same world")
left.legend(loc="upper left")
for policy in config.policies:
    color, _, name = POLICY_STYLES[policy]
    for relation, line in (("null", ":"), ("behind", "-")):
        if policy == "known" and relation == "null":
            continue
        is_won = column(policy, relation, "is_success").astype(bool)
        metres = np.sort(np.where(is_won, column(policy, relation, "distance"), np.inf))
        share = 100 * (np.arange(len(metres)) + 1) / len(metres)
        right.step(metres, share, line, where="post", color=color, label=f"{policy}, {relation}")
right.set(xlabel="metres walked", ylabel="episodes won by then (%)")
right.set(xlim=(0, most), ylim=(0, 101))
right.set_title("how soon they were won")
right.legend(loc="lower right")
figure

# %% [markdown]
# Points under the line are worlds in which `informed` walked less. Empty ones are worlds in which
# the other robot stopped at the wrong hydrant, often sooner for it: metres alone would praise it.
# The curves on the right count only what was won; their tails are what a mean hides.
#
# Any key of the noise or of the planner can be one more axis: `[sensor] detection_probability =
# [0.8, 0.95]`, `[planner] discount = [0.7, 0.9]`. New values compile nothing.
