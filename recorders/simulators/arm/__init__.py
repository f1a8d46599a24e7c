"""A serial arm that holds a payload: what it is, how it moves, which torques that takes."""
