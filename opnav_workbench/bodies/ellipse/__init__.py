"""Center of a body from its limb: sub-pixel limb points, and the outline of its model through them.

Enter by `find_ellipse`.

``centerfinder``
    The method: measured disk, limb points, the outline moved through them, judged.
``limb_points``
    The sub-pixel place of each piece of limb, and which of them count.
``point_fits``
    Position, motion and free ellipse from limb points.
"""
