"""Center of a disk by one likelihood of the pixels about its limb, whatever is painted on it.

Enter by `find_disk`; `measure_disk` for methods that read a disk in another way.

``centerfinder``
    The method: second reading, judgement.
``measurement``
    Place, fit, hits: what all methods of a limb begin from.
``limb_light``
    The light of a disk about its limb, in tables of angle and depth.
``stray_light``
    The light that wings of a PSF, of which nobody knows, may spread beside a disk.
``blocks``
    Pixels in squares, where the light is smooth.
``limb_cells``
    The pixels about a limb, and their means over cells.
``hidden_albedo``
    What albedo between the nodes of a field does to a limb.
``limb_field``
    What pieces of a limb have of their own: an albedo that is a random field, and heights.
``surface_modes``
    The albedo of a disk not much wider than the PSF, which no piece of limb has of its own.
``ring``
    Fields on a ring of blocks, and their linear algebra.
``marginal``
    The likelihood, marginal over the field.
``limb_scatter``
    Whether pieces of limb pull the center as the model has them do.
``tuning``
    The field's prior, as the data speak for it.
``columns``
    What pieces of a limb share, and the light's derivatives by it.
``problem``
    What stays while a disk is fitted: pixels, and what is believed beforehand.
``fit``
    Outline, law, field and the rest, fitted.
``pixel_by_pixel``
    Fits that stand apart, compared.
``starts``
    From where it is fitted.
``fitted``
    A fitted disk.
``sky_edge``
    Where the sky about a disk ends: from where a fit begins as well.
"""
