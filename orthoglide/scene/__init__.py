"""The drawing of a machine in a closed posture, as inline SVG.

Nothing here computes a posture: what is drawn is given in metres, in the base frame.
"""

from orthoglide.scene.drawing import drawing as drawing
from orthoglide.scene.parts import Dial as Dial, Mark as Mark, Option as Option, Posed as Posed
