"""The machine file (TOML): what is known of one machine, read strictly and written exactly."""

from orthoglide.machine_file.model import (
    Controller as Controller,
    DeltaKinematics as DeltaKinematics,
    Dial as Dial,
    Instrument as Instrument,
    MachineFile as MachineFile,
    ParameterValue as ParameterValue,
    Stiffness as Stiffness,
)
from orthoglide.machine_file.posterior import (
    Posterior as Posterior,
    symmetric_root as symmetric_root,
)
from orthoglide.machine_file.toml import (
    AnyMachine as AnyMachine,
    machine_file_contents as machine_file_contents,
    machine_file_of as machine_file_of,
    machine_text as machine_text,
    parse_machine_file as parse_machine_file,
    read_machine_file as read_machine_file,
    write_machine_file as write_machine_file,
)
