"""What shall be done with a picture: one way to say it, and one to do it.

Enter by `process`; `Processing` says how, whether it comes from a command's options, a notebook's parameters, a night's
YAML or a queue; `run_policy` does it with an open session.

``model``
    `Processing`: every option with its description, default and allowed values; targets with their methods.
``automatic``
    The automatic policy on an open session: stars, pointing, targets, and the farther search for bodies.
``body_sequence``
    A body from the pictures of an approach, and the files it leaves: `body_sequence.solve_body_of`.
``carrying``
    Pictures without stars take the pointing of their neighbors.
``pictures``
    Pictures from their files to their folders of results.
``notebook``
    A `Processing` as parameters of notebooks and back; the job of ``process_image.ipynb``.
``queue_file``
    Pictures that wait for an analyst, and how they are processed (``queue.json``).
``star_pictures``
    Star frames for a calibration: pictures solved one after the other.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.processing.automatic import open_picture, run_policy
    from opnav_workbench.processing.model import OpenedProcessing, Processing
    from opnav_workbench.processing.notebook import PictureJob, notebook_parameters, picture_job
    from opnav_workbench.processing.pictures import Outcome, process, process_image, process_images
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "open_picture": "automatic",
            "run_policy": "automatic",
            "OpenedProcessing": "model",
            "Processing": "model",
            "PictureJob": "notebook",
            "notebook_parameters": "notebook",
            "picture_job": "notebook",
            "Outcome": "pictures",
            "process": "pictures",
            "process_image": "pictures",
            "process_images": "pictures",
        },
    )

__all__ = [
    "OpenedProcessing",
    "Outcome",
    "PictureJob",
    "Processing",
    "notebook_parameters",
    "open_picture",
    "picture_job",
    "process",
    "process_image",
    "process_images",
    "run_policy",
]
