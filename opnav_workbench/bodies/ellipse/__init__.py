"""Center of a body from its limb: sub-pixel limb points, and the outline of its model through them.

Enter by `find_ellipse`.

``centerfinder``
    The method: rendered, measured and moved until the limb of the picture lies on that of the model.
``limb_points``
    The limb in pieces, the sub-pixel place of each, and which of them count.
``point_fits``
    Motion and free ellipse from limb points.
``report``
    The result: covariances, flags, status and messages.
"""
