"""The worlds of section 4.2 as environments for agents other than ours.

``functional`` has ``reset`` and ``step`` as pure functions of keys and arrays; ``gymnasium_env``
wraps them for Gymnasium (extra ``gym``).
"""
