"""Lost in space: the attitude from the stars alone, with none to begin with.

Enter by `solve_lost`, with the index of a catalog (`index_of_catalog`).

``patterns``
    Three stars as three numbers that place and twist do not change.
``sky_index``
    The index: the triangles of every star with its nearest brighter ones, in bands of brightness.
``index_file``
    Arrays in one checked, memory-mapped file.
``catalog_index``
    The index of a whole catalog, made once and kept.
``search``
    Triangles looked up, a fourth star asked for, attitudes proposed, mirrored pictures told.
``verification``
    Log odds of an attitude against chance.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.stars.lost_in_space.catalog_index import (
        index_of_catalog,
        is_index_at_hand,
        is_index_made_soon,
    )
    from opnav_workbench.stars.lost_in_space.search import (
        FOCAL_ERROR,
        LostAnswer,
        no_patterns,
        right_handed_axes,
        solve_lost,
    )
    from opnav_workbench.stars.lost_in_space.sky_index import SkyIndex, index_of_stars
    from opnav_workbench.stars.lost_in_space.verification import SURE_LOG_ODDS
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "index_of_catalog": "catalog_index",
            "is_index_at_hand": "catalog_index",
            "is_index_made_soon": "catalog_index",
            "FOCAL_ERROR": "search",
            "LostAnswer": "search",
            "no_patterns": "search",
            "right_handed_axes": "search",
            "solve_lost": "search",
            "SkyIndex": "sky_index",
            "index_of_stars": "sky_index",
            "SURE_LOG_ODDS": "verification",
        },
    )

__all__ = [
    "FOCAL_ERROR",
    "SURE_LOG_ODDS",
    "LostAnswer",
    "SkyIndex",
    "index_of_catalog",
    "index_of_stars",
    "is_index_at_hand",
    "is_index_made_soon",
    "no_patterns",
    "right_handed_axes",
    "solve_lost",
]
