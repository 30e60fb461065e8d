"""Pictures of a machine from its closed posture: a drawing on paper, and one to turn and move.

Nothing here computes a posture: what is drawn is given in metres, in the base frame.
"""

from orthoglide.scene.drawing import drawing
from orthoglide.scene.parts import Dial, Mark, Option, Posed
from orthoglide.scene.view import View, Way, view_html, view_page
