"""Machine files and readings from what the firmware of a machine stores.

Each package in this folder is an add-on for one firmware, found as `orthoglide.add_ons` says.
"""
