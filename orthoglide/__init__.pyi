"""Public names, and the modules in which they are; `orthoglide/__init__.py` reads them here."""

from orthoglide.as_pinocchio import (
    PinocchioModel as PinocchioModel,
    pinocchio_model as pinocchio_model,
)
from orthoglide.checking import Check as Check, check as check
from orthoglide.comparison import (
    compare_effects as compare_effects,
    compare_machine as compare_machine,
)
from orthoglide.control import (
    Compensation as Compensation,
    ControllerNumbers as ControllerNumbers,
    calibrated_mjcf as calibrated_mjcf,
    calibrated_urdf as calibrated_urdf,
    compensate as compensate,
    controller_numbers as controller_numbers,
    export_files as export_files,
    read_path as read_path,
)
from orthoglide.effects import (
    Effect as Effect,
    Motion as Motion,
    Parameter as Parameter,
    Words as Words,
    once as once,
    sideways as sideways,
)
from orthoglide.errors import (
    ClosureError as ClosureError,
    CrossCheckError as CrossCheckError,
    FileError as FileError,
    InputError as InputError,
    NumericsError as NumericsError,
    OrthoglideError as OrthoglideError,
    SolverError as SolverError,
    UnidentifiableError as UnidentifiableError,
    UnreachableError as UnreachableError,
)
from orthoglide.explanation.identifying import identify as identify
from orthoglide.firmware.imported import Imported as Imported
from orthoglide.firmware.klipper import import_printer as import_printer
from orthoglide.firmware.plate_lists import import_plates as import_plates
from orthoglide.fit import Estimate as Estimate
from orthoglide.geometry import Geometry as Geometry
from orthoglide.layout import FreeLeg as FreeLeg, FreeLegs as FreeLegs, LinearDelta as LinearDelta
from orthoglide.machine import Machine as Machine, Pose as Pose
from orthoglide.machine_file import (
    Dial as Dial,
    Instrument as Instrument,
    MachineFile as MachineFile,
)
from orthoglide.mechanism import Mechanism as Mechanism
from orthoglide.observations import (
    Campaign as Campaign,
    Readings as Readings,
    Setup as Setup,
    TcpPoints as TcpPoints,
    ToolCampaign as ToolCampaign,
    ToolSetup as ToolSetup,
    protocol as protocol,
    read_campaign as read_campaign,
    read_readings as read_readings,
    read_tcp as read_tcp,
    write_campaign as write_campaign,
)
from orthoglide.planning import (
    Suggestion as Suggestion,
    design as design,
    next_measurements as next_measurements,
    repeats_needed as repeats_needed,
    smallest_effects as smallest_effects,
    tool_sheets as tool_sheets,
)
from orthoglide.planning.designs import Design as Design
from orthoglide.rehearsal import Rehearsal as Rehearsal, rehearse as rehearse
from orthoglide.result import Result as Result
from orthoglide.simulation import simulate as simulate, simulate_tcp as simulate_tcp
from orthoglide.transmission import (
    CubeTransmission as CubeTransmission,
    transmission_factors as transmission_factors,
    transmission_over_cube as transmission_over_cube,
)
from orthoglide.units import MM as MM, ONE as ONE, RAD as RAD, Unit as Unit
from orthoglide.verdict import Verdict as Verdict, close_loop as close_loop

__version__: str
