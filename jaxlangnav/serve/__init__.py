"""``jaxlangnav serve``: a page on this machine to talk to the robot while it searches."""
