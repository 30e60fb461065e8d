"""Pictures of a machine from its closed posture: a drawing on paper, and one to turn and move.

Nothing here computes a posture: what is drawn is given in metres, in the base frame.
"""

from orthoglide.scene.drawing import drawing as drawing
from orthoglide.scene.parts import Dial as Dial, Mark as Mark, Option as Option, Posed as Posed
from orthoglide.scene.view import (
    View as View,
    Way as Way,
    view_html as view_html,
    view_page as view_page,
)
