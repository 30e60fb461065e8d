"""The machine file (TOML): what is known of one machine, read strictly and written exactly."""

from orthoglide.machine_file.model import (
    SCHEMA,
    Controller,
    Dial,
    Instrument,
    MachineFile,
    ParameterValue,
    Stiffness,
    nominal_machine_file,
)
from orthoglide.machine_file.posterior import Posterior
from orthoglide.machine_file.reading import parse_machine_file, read_machine_file
from orthoglide.machine_file.writing import machine_files, machine_text, write_machine_file
