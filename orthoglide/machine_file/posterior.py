"""Mean and covariance of parameters, and the file that keeps them beside a machine file."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orthoglide import files
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array
from orthoglide.text import shown

_CONTENT = ("names", "mean", "covariance", "sha256")


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """What is known of parameters, as a Gaussian.

    Attributes:
        names: of the parameters, ``P`` of them.
        mean: ``(P,)``, SI.
        covariance: ``(P, P)``, SI.
        read: the same as the readings alone have it, with every effect as far off as its
            tolerance lets expect ``(P, P)``: what was learned of some parameters says nothing of
            another that the readings did not see; ``None`` where there is no difference.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array
    read: Array | None = None

    def __post_init__(self) -> None:
        count = (len(self.names),)
        if self.mean.shape != count or self.covariance.shape != 2 * count:
            raise InputError(
                f"{count[0]} names need as many values, and a covariance of that many rows and "
                f"columns"
            )
        if self.read is not None and self.read.shape != self.covariance.shape:
            raise InputError("both covariances are of the same parameters")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise InputError("a mean and a covariance are finite numbers")

    @classmethod
    def independent(cls, values: Mapping[str, float], sigmas: Mapping[str, float]) -> Posterior:
        """Parameters of which each is known apart from the others, SI."""
        names = tuple(sigmas)
        mean = np.array([values.get(n, 0.0) for n in names])
        return cls(names, mean, np.diag(np.square([sigmas[n] for n in names]).reshape(-1)))

    @property
    def as_read(self) -> Posterior:
        """What the readings alone say."""
        return self if self.read is None else Posterior(self.names, self.mean, self.read)

    def without(self, names: Collection[str]) -> Posterior:
        """What is known of the others, these left open."""
        kept = [k for k, n in enumerate(self.names) if n not in names]
        return Posterior(
            tuple(self.names[k] for k in kept),
            self.mean[kept],
            self.covariance[np.ix_(kept, kept)],
            None if self.read is None else self.read[np.ix_(kept, kept)],
        )

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name, SI."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(self.names, spread.tolist(), strict=True))

    @property
    def root(self) -> Array:
        """A matrix ``(P, P)`` whose product with its transpose is the covariance.

        In units of the standard deviations it is symmetric: eigenvectors alone would leave signs,
        and turns among equal eigenvalues, to rounding, and draws with them.
        """
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        unit = np.where(sd > 0, sd, 1.0)
        values, vectors = np.linalg.eigh(self.covariance / unit / unit[:, None])
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        return np.asarray(unit[:, None] * root)

    def mapped(self, names: Sequence[str], matrix: Array) -> Posterior:
        """Of linear combinations: ``matrix`` ``(Q, P)`` gives the parameters ``names``."""
        spread = matrix @ self.covariance @ matrix.T
        return Posterior(tuple(names), matrix @ self.mean, spread)

    def about(self, values: Mapping[str, float]) -> Posterior:
        """The same about other values, whose distance from the mean counts as variance."""
        centre = np.array([values.get(n, 0.0) for n in self.names])
        apart = self.mean - centre
        further = np.outer(apart, apart)
        read = None if self.read is None else self.read + further
        return Posterior(self.names, centre, self.covariance + further, read)

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
    """The content of that file, the same bytes for the same numbers.

    Args:
        posterior: what to keep.
        digest: sha256 of the machine file that it belongs to.
    """
    arrays = {
        "names": np.array(posterior.names, dtype=np.str_),
        "mean": posterior.mean,
        "covariance": posterior.covariance,
        "sha256": np.array(digest),
        **({} if posterior.read is None else {"read": posterior.read}),
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array, order="C"), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy")  # of no date, where np.savez may differ
            archive.writestr(entry, content.getvalue())
    return stream.getvalue()


def read_posterior(path: str | os.PathLike[str], digest: str) -> Posterior | None:
    """The covariance kept beside a machine file; ``None`` where there is none.

    Args:
        path: of the machine file.
        digest: sha256 of its content.

    Raises:
        FileError: where the file is damaged or belongs to another machine file.
    """
    beside = posterior_path(path)
    if not beside.exists():
        return None
    return parse_posterior(files.read_bytes(beside), digest, shown(beside))


def parse_posterior(content: bytes, digest: str, file: str) -> Posterior:
    """A covariance from the bytes that `posterior_bytes` made; raises as `read_posterior`."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            names, mean, covariance, belongs_to = (stored[key] for key in _CONTENT)
            read = stored["read"].astype(float) if "read" in stored else None
        found = Posterior(
            tuple(map(str, names)), mean.astype(float), covariance.astype(float), read
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
