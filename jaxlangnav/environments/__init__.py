"""Reinforcement-learning environments of section 4.2's worlds and of any world file.

``functional`` has ``reset`` and ``step`` as pure functions of keys and arrays; ``gymnasium_env``
wraps them for Gymnasium (extra ``gym``), which knows them by ``ID`` from here on.
"""

import contextlib

ID = "jaxlangnav/Follow-v2"

with contextlib.suppress(ImportError):
    import gymnasium

    _MODULE = "jaxlangnav.environments.gymnasium_env"
    if ID not in gymnasium.registry:
        gymnasium.register(
            ID, entry_point=f"{_MODULE}:FollowEnv", vector_entry_point=f"{_MODULE}:FollowVectorEnv"
        )
