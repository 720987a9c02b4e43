"""Landmarks: small patches of a body's surface, found in pictures, and the camera's pose from them.

Enter by `Maplets.read` (or `make_maplets`, from a shape) and `find_landmarks` on a `BodyPicture`; by `pose_from_landmarks`
for measured points of any origin.

``maplets``
    Patches of the surface: heights and albedo on local grids, their file.
``making``
    Maplets made from a shape or an ellipsoid, with an albedo map.
``prediction``
    Where landmarks appear, which can be found, and their partials.
``drawing``
    Maplets drawn as the picture would see them.
``matching``
    Correlation and first fit of a patch; what its residuals have in common.
``whitening``
    The fit again, under the correlated errors that a drawn surface has, and its covariance.
``results``
    Centers, statuses and poses.
``pose``
    Position and attitude of the camera, robust, with covariance.
``finder``
    From a picture to judged landmarks.
``patches``
    What a person looks at to judge a landmark: patch, drawing, correlation.
``lost``
    The same where nobody knows the body's place: from its silhouette first.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.landmarks.finder import find_landmarks, judge_landmarks, posed, predicted_again
    from opnav_workbench.landmarks.lost import (
        SilhouettePlace,
        find_lost_landmarks,
        place_from_silhouette,
    )
    from opnav_workbench.landmarks.making import ellipsoid_shape, make_maplets
    from opnav_workbench.landmarks.maplets import Maplets
    from opnav_workbench.landmarks.patches import LandmarkPatch, landmark_patches
    from opnav_workbench.landmarks.pose import (
        PosedLandmarks,
        PoseKnowledge,
        camera_position_from_landmarks,
        pose_from_landmarks,
    )
    from opnav_workbench.landmarks.prediction import (
        LandmarkPartials,
        LandmarkPrediction,
        landmark_partials,
        predict_landmarks,
    )
    from opnav_workbench.landmarks.results import (
        LANDMARK_STATUSES,
        LandmarkCenters,
        LandmarkSolution,
        PoseSolution,
    )
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "find_landmarks": "finder",
            "judge_landmarks": "finder",
            "posed": "finder",
            "predicted_again": "finder",
            "SilhouettePlace": "lost",
            "find_lost_landmarks": "lost",
            "place_from_silhouette": "lost",
            "ellipsoid_shape": "making",
            "make_maplets": "making",
            "Maplets": "maplets",
            "LandmarkPatch": "patches",
            "landmark_patches": "patches",
            "PosedLandmarks": "pose",
            "PoseKnowledge": "pose",
            "camera_position_from_landmarks": "pose",
            "pose_from_landmarks": "pose",
            "LandmarkPartials": "prediction",
            "LandmarkPrediction": "prediction",
            "landmark_partials": "prediction",
            "predict_landmarks": "prediction",
            "LANDMARK_STATUSES": "results",
            "LandmarkCenters": "results",
            "LandmarkSolution": "results",
            "PoseSolution": "results",
        },
    )

__all__ = [
    "LANDMARK_STATUSES",
    "LandmarkCenters",
    "LandmarkPartials",
    "LandmarkPatch",
    "LandmarkPrediction",
    "LandmarkSolution",
    "Maplets",
    "PoseKnowledge",
    "PoseSolution",
    "PosedLandmarks",
    "SilhouettePlace",
    "camera_position_from_landmarks",
    "ellipsoid_shape",
    "find_landmarks",
    "find_lost_landmarks",
    "judge_landmarks",
    "landmark_partials",
    "landmark_patches",
    "make_maplets",
    "place_from_silhouette",
    "pose_from_landmarks",
    "posed",
    "predict_landmarks",
    "predicted_again",
]
