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
# # Quickstart: a sentence to a picture
#
# A person says *go to the hydrant behind the cone*. The robot has never been here: it knows the
# sentence and the edges of its operating area, and it sees three metres far.

# %%
# %matplotlib inline
import jaxlangnav
from jaxlangnav.viz.panels import belief_figure

jaxlangnav.keep_compiled_programs()  # so that the next run starts in seconds
recording = jaxlangnav.follow("go to the hydrant behind the cone", world="1H1C", seed=0)
belief_figure(recording)

# %% [markdown]
# Every dot is a hypothesis: each of 64 particles keeps a map of its own, in which the sentence is
# true. Hypotheses that fall into view and are not there are refuted; once the cone is seen, the
# hydrants gather behind it.
#
# ## The same as a story

# %%
from jaxlangnav.viz.narrative import narrate

print(*narrate(recording), sep="\n")

# %% [markdown]
# ## Anything in it is an array
#
# `recording.frames` holds every step, the first axis of each array; `recording.scene` what stays
# the same, `recording.result` how it ended.

# %%
frames, result = recording.frames, recording.result
print("particles' weights:", frames.weight.shape, " values of waypoints:", frames.value.shape)
print("hypothesised x (mention, particle):", frames.hypothesis_x.shape)
print(f"success {bool(result.is_success)} after {float(result.distance):.1f} m;", end=" ")
print(f"with the map known it would have been {recording.scene.known_distance:.1f} m")

# %% [markdown]
# ## Another sentence, another world
#
# A sentence is data: the second one compiles nothing. `street` is a shipped world whose robot
# sees only ahead; a file of your own works as well (`your_own_world`).

# %%
belief_figure(jaxlangnav.follow("find the bench", world="street"), num_panels=3)

# %% [markdown]
# `viz.html.write_report_files(recording, "pictures")` writes these figures, the story, and an
# interactive page with a slider over time.
