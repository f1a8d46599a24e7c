"""From pictures to where the ball is in them: found by how it moves, then by how it looks."""
