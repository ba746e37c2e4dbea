"""Control: how the vehicle is made to follow a plan."""
