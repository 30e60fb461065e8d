"""The general model: a Pinocchio tree with loop closures, and the same tree in CasADi."""

from orthoglide.mechanism.mechanism import Mechanism as Mechanism
