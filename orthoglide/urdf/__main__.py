"""``python -m orthoglide.urdf [FOLDER]`` writes both files."""

import sys

from orthoglide.urdf import write

for written in write(sys.argv[1] if len(sys.argv) > 1 else "urdf"):
    print(written)
