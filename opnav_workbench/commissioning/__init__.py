"""A new mission from an instrument kernel or a few numbers, and a picture: its files, and what was known and guessed.

Enter by `new_mission`.

``header_words``
    Which words of a picture's header hold time, exposure, attitude, target.
``cameras``
    The camera that took a picture, from instrument kernels or numbers.
``orientation``
    How the detector lies in its frame: the eight ways, against the stars or the limb of the picture.
``files``
    Mission, camera and scenario files.
``new_mission``
    All of it in one call, with the picture solved and simulated to compare.
"""

from opnav_workbench.commissioning.new_mission import NewMission, Wanted, new_mission

__all__ = ["NewMission", "Wanted", "new_mission"]
