"""A serial arm that holds a payload: its description, motion and joint torques."""
