r"""The nominal mechanism as URDF with a file of loop closures (``python -m orthoglide.urdf``).

URDF describes a tree without loops. The loops are cut at one pivot of each parallelogram and at the
platform, of which every leg has a copy; ``closures`` lists the frames that coincide::

    base -slide-> carriage -theta-> fork -bar1-> bar1 -knuckle-> knuckle -platform-> platform = tcp
                                     \ -bar2-> bar2 = bar2_tip      \= knuckle_tip

Every link of a leg has its axes along the leg's (a, b, c) where all joint positions are zero, and
that is the closed machine at mechanical zero, p = 0. The kinematics are the paper's (Pashkevich et
al. 2008, section 2.1); thicknesses, masses and the frame are plausible and not measured.
"""

from orthoglide.urdf.parallel import (
    ParallelRobot as ParallelRobot,
    parallel_robot_files as parallel_robot_files,
    read_looped_urdf as read_looped_urdf,
    read_parallel_robot as read_parallel_robot,
)
from orthoglide.urdf.tree import (
    CLOSURES_FILE as CLOSURES_FILE,
    URDF_FILE as URDF_FILE,
    Closure as Closure,
    closures as closures,
    closures_text as closures_text,
    file_names as file_names,
    shipped_folder as shipped_folder,
    to_urdf as to_urdf,
    write as write,
)
