"""Pictures, recordings and stories of what the engine did; for people, on the host.

matplotlib, rich and rerun are imported where they are used; matplotlib comes with the extra
``viz``. ``html.write_pictures`` writes everything there is to see of one episode.
"""
