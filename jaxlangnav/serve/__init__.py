"""``jaxlangnav serve``: a local web page to talk to the robot while it searches."""
