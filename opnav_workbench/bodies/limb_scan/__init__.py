"""Center of a body by scans across its limb (AAS 13-443): brightness along lines that radiate from the center.

Enter by `find_limb_scan`.

``centerfinder``
    The method from the coarse search to the result, with flags, status and messages.
``fan``
    Where scans run, and pictures sampled along them.
``view``
    What scans show: data, rendered model, and profiles of an uneven albedo.
``matching``
    Offsets of scans from the model, and what all scans share.
``acquisition``
    From the coarse place to within a pixel.
``selection``
    Which scans make the center, and why.
``center_solution``
    From offsets to the center, with its covariance.
``iteration``
    Model, offsets and center in turn, until the center stays.
"""
