"""After ``warm_up`` no utterance compiles anything: JAX counts, in a process of its own."""

import subprocess
import sys

from jaxlangnav.language.utterance import Kind

SCRIPT = """
import jax
import jax.numpy as jnp
import numpy as np
from jaxlangnav.navigator import api
from jaxlangnav.messages import Status
from jaxlangnav.pytree import replace

compiled = []


def listen(name, seconds, **about):
    if name.endswith("backend_compile_duration"):
        compiled.append(about.get("fun_name"))


one = api.Navigator.pretrained({numbers})
# The decision cycle, most of a minute to compile, is counted in test_navigator_step.
api._step = lambda key, state, look, **rest: (state, None, None)
one.warm_up()
jax.monitoring.register_event_duration_secs_listener(listen)
idle = one.wait()
state = one.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
one.start("go two metres forward and then one metre to the left")
assert not compiled, compiled
# Two things seen may be meant, the first of which is approached; made without JAX.
shares, particles = np.zeros_like(state.talk.candidate), state.belief.particles
shares[:2] = 0.6, 0.4
kinds = np.array(particles.object_type)
kinds[:2] = 0
state = replace(
    state,
    belief=replace(state.belief, particles=replace(particles, object_type=jax.device_put(kinds))),
    talk=replace(state.talk, approached=jnp.int32(0), candidate=jax.device_put(shares)),
)
asked = replace(state, status=jnp.int32(Status.WHICH_ONE))
shapes = jax.tree.map(jax.typeof, state)
SAID = (
    "go to the cone", "then go to the cone", "there is a tree left of the cone",
    "keep away from the car", "go three metres forward", "no, I meant the cone",
    "not that one, the one by the cone", "go to the other hydrant", "stop", "go on",
    "never mind", "come back", "the other one", "closer", "never mind, come back",
)  # fmt: skip
ANSWERS = ("the left one", "the second", "the nearest", "any", "no", "the one by the cone")
for told, texts in ((idle, SAID[:4]), (state, SAID), (asked, ANSWERS)):
    for text in texts:
        after, heard = one.take(told, text)
        assert jax.tree.map(jax.typeof, after) == shapes, text
        bool(after.is_resting)
        for ask in (one.candidates, one.missing, one.spoken):
            ask(after)
        print(heard.kind.name, text)
        assert not compiled, (text, compiled)
"""


def test_after_warming_up_no_utterance_compiles_anything() -> None:
    for numbers in ("", "heading_noise=0.01"):
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", SCRIPT.replace("{numbers}", numbers)],
            capture_output=True,
            text=True,
            timeout=600,
        )
        assert done.returncode == 0, done.stderr[-1000:]
        kinds = {line.split()[0] for line in done.stdout.splitlines()}
        assert kinds == {kind.name for kind in Kind}
