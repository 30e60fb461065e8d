"""Figures as SVG.

Texts stay texts and colours are named (see `style`), so that the page can give them its own font
and its colours of day and night. The same result gives the same bytes.
"""

# Modules are imported by name, when something is to be drawn: matplotlib takes its time.
