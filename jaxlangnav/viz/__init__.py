"""Visualisation of episodes: figures, videos, web pages and narratives (host only).

matplotlib, rich and rerun are imported where they are used; matplotlib comes with the extra
``viz``. ``html.write_report_files`` writes everything there is to see of one episode.
"""
