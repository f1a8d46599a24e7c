"""From pictures to where the ball is in them: found by how it moves, then by how it looks.

`track` tells the whole of it: against a `background` there are `candidates`, among them the longest
free flight (`arcs`); how what flew looks is then learnt (`learning`), and it is found again in all
pictures (`redetection`) by a fit of its `appearance` (`drawn_ball`); `following` picks one
candidate of each picture. `pictures` reads them; `thumbnails` and `ball_picker` let a user show the
ball.
"""
