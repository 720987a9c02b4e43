"""Center of a body by scans across its limb (AAS 13-443): brightness along lines that radiate from the center.

Enter by `find_limb_scan`.

``centerfinder``
    The method: measured disk, scans about its center, judgement, what every scan showed.
``scanning``
    Scans until the outline stands still, and the center they agree with: what the limb scan and the ellipse share.
``fan``
    Where scans run, and pictures sampled along them.
``view``
    What scans show: data and the light of the disk's tables, on the same points.
``matching``
    Offset of each scan from the model: weighted correlation.
``selection``
    Which scans make the center, and why.
``center_solution``
    From offsets to the outline, with its covariance.
"""
