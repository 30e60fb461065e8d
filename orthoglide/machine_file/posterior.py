"""Mean and covariance of parameters, and their file beside a machine file."""

from __future__ import annotations

import io
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array


def symmetric_root(covariance: Array) -> Array:
    """Return a matrix ``(P, P)`` whose product with its transpose is a covariance.

    It is symmetric in units of the standard deviations. With eigenvectors alone, signs and the
    basis of equal eigenvalues would depend on rounding, and random draws with them.
    """
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / unit / unit[:, None])
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return np.asarray(unit[:, None] * root)


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """Gaussian distribution of parameters."""

    names: tuple[str, ...]  # of the parameters, `P` of them
    mean: Array  # (P,), SI
    covariance: Array  # (P, P), SI
    # variance of each parameter by the readings, if it alone were off by its tolerance (P,), SI: a
    # prior by which most errors are small says little of one that the readings do not determine;
    # 0 for parameters that are free anyway, `None` if not computed
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
        """Return the marginal distribution of the other parameters."""
        rows = [k for k, n in enumerate(self.names) if n not in names]
        return Posterior(
            tuple(self.names[k] for k in rows),
            self.mean[rows],
            self.covariance[np.ix_(rows, rows)],
            None if self.conditional_variance is None else self.conditional_variance[rows],
        )

    def regression(self, names: Sequence[str], given: Sequence[str]) -> tuple[Array, Array]:
        """Return the slopes ``(k, g)`` of some parameters by given ones, and the covariance
        ``(k, k)`` that these leave.
        """
        rows, others = ([self.names.index(n) for n in part] for part in (names, given))
        sd = np.sqrt(np.maximum(np.diag(self.covariance)[others], 1e-300))
        among = self.covariance[np.ix_(others, others)] / sd / sd[:, None]
        across = self.covariance[np.ix_(rows, others)] / sd
        slopes = across @ np.linalg.pinv(among, rcond=1e-9, hermitian=True)
        return slopes / sd, self.covariance[np.ix_(rows, rows)] - slopes @ across.T

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name, SI."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(self.names, sd.tolist(), strict=True))

    @property
    def covariance_root(self) -> Array:
        """Matrix ``(P, P)`` whose product with its transpose is the covariance."""
        return symmetric_root(self.covariance)

    def transformed(self, names: Sequence[str], matrix: Array) -> Posterior:
        """Return the distribution of linear combinations; ``matrix`` ``(Q, P)`` gives ``names``."""
        covariance = matrix @ self.covariance @ matrix.T
        return Posterior(tuple(names), matrix @ self.mean, covariance)

    def recentred(self, values: Mapping[str, float]) -> Posterior:
        """Return the distribution about other values; their shift from the mean adds variance."""
        centre = np.array([values.get(n, 0.0) for n in self.names])
        shift = self.mean - centre
        covariance = self.covariance + np.outer(shift, shift)
        return Posterior(self.names, centre, covariance, self.conditional_variance)

    def joined(self, other: Posterior) -> Posterior:
        """Return this distribution with further parameters of another, taken as independent."""
        further = other.without(self.names)
        count = len(self.names)
        covariance = np.zeros((count + len(further.names),) * 2)
        covariance[:count, :count] = self.covariance
        covariance[count:, count:] = further.covariance
        mean = np.concatenate([self.mean, further.mean])
        return Posterior((*self.names, *further.names), mean, covariance)


def posterior_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of the covariance's file beside a machine file: ``calibrated.npz``."""
    return Path(path).with_suffix(".npz")


def posterior_bytes(posterior: Posterior, digest: str) -> bytes:
    """Return the content of that file, identical bytes for identical numbers; ``digest`` is the
    sha256 of its machine file.
    """
    arrays: dict[str, Any] = {
        "names": np.array(posterior.names, dtype=np.str_),
        "mean": posterior.mean,
        "covariance": posterior.covariance,
        "sha256": np.array(digest),
    }
    if posterior.conditional_variance is not None:
        arrays["alone"] = posterior.conditional_variance
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def parse_posterior(content: bytes, digest: str, file: str) -> Posterior:
    """Return a posterior from the bytes of `posterior_bytes`; ``digest`` is the sha256 of the
    machine file beside it.

    Raises:
        FileError: if it is damaged or belongs to another machine file.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            names, stored_digest = tuple(map(str, stored["names"])), str(stored["sha256"])
            mean, covariance = (stored[key].astype(float) for key in ("mean", "covariance"))
            conditional_variance = stored["alone"].astype(float) if "alone" in stored else None
        posterior = Posterior(names, mean, covariance, conditional_variance)
    except Exception:  # a damaged archive fails in as many ways as it can be damaged
        raise FileError("is damaged: write the machine again", file=file) from None
    if stored_digest != digest:
        raise FileError(
            "belongs to another machine file than the one beside it: put back the one it was "
            "written with, or remove this to take its parameters for independent",
            file=file,
        )
    return posterior
