"""Mean and covariance of parameters, and the file that keeps them beside a machine file."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array

_ARRAY_NAMES = ("names", "mean", "covariance", "sha256")


def symmetric_root(covariance: Array) -> Array:
    """A matrix ``(P, P)`` whose product with its transpose is a covariance.

    In units of the standard deviations it is symmetric: eigenvectors alone would leave signs, and
    turns among equal eigenvalues, to rounding, and draws with them.
    """
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / unit / unit[:, None])
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return np.asarray(unit[:, None] * root)


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """What is known of parameters, as a Gaussian."""

    names: tuple[str, ...]  # of the parameters, `P` of them
    mean: Array  # (P,), SI
    covariance: Array  # (P, P), SI
    # variance of each as the readings have it were it off as far as its tolerance lets expect, all
    # others as they are (P,), SI: that most are small says little of one that the readings did not
    # see; 0 of what is as free already, `None` of all
    conditional_variance: Array | None = None

    def __post_init__(self) -> None:
        count = (len(self.names),)
        if self.mean.shape != count or self.covariance.shape != 2 * count:
            raise InputError(
                f"{count[0]} names need as many values, and a covariance of that many rows and "
                f"columns"
            )
        if self.conditional_variance is not None and self.conditional_variance.shape != count:
            raise InputError("each parameter has one variance of its own")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise InputError("a mean and a covariance are finite numbers")

    def without(self, names: Collection[str]) -> Posterior:
        """What is known of the others, these left open."""
        kept = [k for k, n in enumerate(self.names) if n not in names]
        return Posterior(
            tuple(self.names[k] for k in kept),
            self.mean[kept],
            self.covariance[np.ix_(kept, kept)],
            None if self.conditional_variance is None else self.conditional_variance[kept],
        )

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name, SI."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(self.names, spread.tolist(), strict=True))

    @property
    def covariance_root(self) -> Array:
        """A matrix ``(P, P)`` whose product with its transpose is the covariance."""
        return symmetric_root(self.covariance)

    def transformed(self, names: Sequence[str], matrix: Array) -> Posterior:
        """Of linear combinations: ``matrix`` ``(Q, P)`` gives the parameters ``names``."""
        spread = matrix @ self.covariance @ matrix.T
        return Posterior(tuple(names), matrix @ self.mean, spread)

    def recentred(self, values: Mapping[str, float]) -> Posterior:
        """The same about other values, whose distance from the mean counts as variance."""
        centre = np.array([values.get(n, 0.0) for n in self.names])
        apart = self.mean - centre
        spread = self.covariance + np.outer(apart, apart)
        return Posterior(self.names, centre, spread, self.conditional_variance)

    def joined(self, other: Posterior) -> Posterior:
        """With the parameters of another that are not in this, taken for independent of these."""
        rest = [k for k, name in enumerate(other.names) if name not in self.names]
        count = len(self.names)
        covariance = np.zeros((count + len(rest), count + len(rest)))
        covariance[:count, :count] = self.covariance
        covariance[count:, count:] = other.covariance[np.ix_(rest, rest)]
        names = (*self.names, *(other.names[k] for k in rest))
        return Posterior(names, np.concatenate([self.mean, other.mean[rest]]), covariance)


def posterior_path(path: str | os.PathLike[str]) -> Path:
    """The file beside a machine file that keeps the covariance: ``calibrated.npz``."""
    return Path(path).with_suffix(".npz")


def posterior_bytes(posterior: Posterior, digest: str) -> bytes:
    """The content of that file, the same bytes for the same numbers; ``digest`` is the sha256 of
    the machine file that it belongs to.
    """
    arrays = {
        "names": np.array(posterior.names, dtype=np.str_),
        "mean": posterior.mean,
        "covariance": posterior.covariance,
        "sha256": np.array(digest),
        **(
            {}
            if posterior.conditional_variance is None
            else {"alone": posterior.conditional_variance}
        ),
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array, order="C"), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy")  # of no date, where np.savez may differ
            archive.writestr(entry, content.getvalue())
    return stream.getvalue()


def parse_posterior(content: bytes, digest: str, file: str) -> Posterior:
    """A covariance from the bytes that `posterior_bytes` made, kept with the machine file of which
    this is the sha256.

    Raises:
        FileError: where it is damaged or belongs to another machine file.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            names, mean, covariance, belongs_to = (stored[key] for key in _ARRAY_NAMES)
            alone = stored["alone"].astype(float) if "alone" in stored else None
        found = Posterior(
            tuple(map(str, names)), mean.astype(float), covariance.astype(float), alone
        )
    except Exception:  # a damaged archive fails in as many ways as it can be damaged
        raise FileError("is damaged: write the machine again", file=file) from None
    if str(belongs_to) != digest:
        raise FileError(
            "belongs to another machine file than the one beside it: put back the one it was "
            "written with, or remove this to take its parameters for independent",
            file=file,
        )
    return found
