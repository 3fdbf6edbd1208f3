"""The one statement of the physics: a vehicle's parameters, its kinematics, suspension, contact and equations of motion, and the track.

Imports base. The equations of the paper and where they stand are listed in notebooks/pages/contributing.md."""
