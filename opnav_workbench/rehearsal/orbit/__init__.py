"""Rehearsals in orbit: a map of the body that is not quite true, landmarks found with it, and one batch over all pictures.

``team_map``
    What the team gets of the surface: maplets and a shape made of the true one, smoothed, stretched and scattered.
``solution``
    The team's estimate of orbit, body and map, and its file.
``scoring``
    Landmarks, pointings and the solution held against the truth.
"""
