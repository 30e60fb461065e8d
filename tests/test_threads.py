"""Linear algebra of the package runs on one thread, and leaves its caller's threads alone."""

import threadpoolctl

import orthoglide as og
from orthoglide.threads import on_one_thread


def threads() -> list[int]:
    found = threadpoolctl.threadpool_info()
    return [one["num_threads"] for one in found if one["user_api"] == "blas"]


def test_one_thread_within_and_the_callers_own_after() -> None:
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        given = threads()
        assert on_one_thread(threads)() == [1] * len(given)
        assert threads() == given


def test_what_takes_long_runs_on_one_thread(monkeypatch) -> None:
    seen: list[int] = []
    campaign = og.simulate(og.Machine.nominal(), og.protocol("standard"), seed=1)
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        og.close_loop([campaign], progress=lambda step: seen.extend(threads()))
    assert seen
    assert set(seen) == {1}
