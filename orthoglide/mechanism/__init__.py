"""The general model: a Pinocchio tree with loop closures, and six bars derived from it."""

from orthoglide.mechanism.mechanism import Mechanism as Mechanism
