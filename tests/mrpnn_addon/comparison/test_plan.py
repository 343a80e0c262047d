# SPDX-License-Identifier: GPL-3.0-or-later
"""What a comparison renders next, and what it stores on disk."""

import importlib

import numpy as np
import pytest


@pytest.fixture
def plan(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.comparison.plan")


@pytest.fixture
def kept(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.cycles.pass_store")


@pytest.fixture
def choices(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.cycles.choices")


def run(plan, kept, request, done=None, each=1.0, most=200):
    """Follow the plan with passes that take `each` seconds per sample; gives the jobs in order and all passes."""
    done, order, spent = dict(done or {}), [], 0.0
    while (job := plan.next_job(request, done, spent=spent)) is not None and len(order) < most:
        seconds = each * job.samples
        done[job] = kept.Pass(np.zeros((1, 1, 4), np.float32), seconds, seconds)
        spent += seconds * job.by_cycles
        order.append(job)
    return order, done, spent


def test_without_a_limit_everything_is_rendered_once(plan, kept, choices):
    layers = (kept.Job("mrpnn", 8), kept.Job("mrpnn", 2))
    order, _, _ = run(plan, kept, plan.Request(layers, samples=40, largest=20))
    assert len(order) == len(set(order)) and order[:2] == list(layers)
    references = [job for job in order if job.method == choices.REFERENCE]
    # Halves of 16 + 16 + 8, seeds all different.
    assert [job.samples for job in references[::2]] == [job.samples for job in references[1::2]] == [16, 16, 8]
    assert {job.seed for job in references} == set(range(6))
    for method in (choices.CYCLES, choices.DENOISED):
        assert [job.samples for job in order if job.method == method] == [1, 4, 16]


def test_the_budget_is_kept_and_the_next_run_resumes(plan, kept, choices):
    request = plan.Request((kept.Job("mrpnn", 8),), samples=160, largest=1024, seconds=150.0)
    first, done, spent = run(plan, kept, request)
    assert 100.0 < spent <= 150.0
    # Half of the budget at most is the ladder's; both halves of the reference are there.
    assert sum(job.samples for job in first if job.method in (choices.CYCLES, choices.DENOISED)) <= 75.0
    assert {job.seed % 2 for job in first if job.method == choices.REFERENCE} == {0, 1}
    second, _, more = run(plan, kept, request, done)
    assert not set(first) & set(second) and 0.0 < more <= 150.0


def test_the_minimum_is_rendered_whatever_the_budget(plan, kept, choices):
    order, _, _ = run(plan, kept, plan.Request((kept.Job("mrpnn", 8),), seconds=1e-3))
    assert [(job.method, job.samples) for job in order] == [
        ("mrpnn", 8),
        (choices.REFERENCE, 16),
        (choices.REFERENCE, 16),
        (choices.CYCLES, 1),
        (choices.DENOISED, 1),
    ]


def test_both_ways_through_volumes_are_measured_and_each_is_expected_to_take_what_it_took(plan, kept, choices):
    assert plan.ladders(True, null=False) == (choices.CYCLES, choices.DENOISED)
    both = plan.ladders(False, null=True)
    assert both == (choices.CYCLES, choices.NULL)
    usual = plan.usual_jobs(null=True)
    assert set(plan.usual_jobs(null=False)) == {job for job in usual if "null" not in job.method}
    request = plan.Request((), samples=16, largest=4, methods=both, usual=usual)
    slow = {job: 30.0 if "null" in job.method else 1.0 for job in request.cycles_jobs()}
    made = {job: kept.Pass(np.zeros((1, 1, 4), np.float32), each * job.samples, 0.0) for job, each in slow.items()}
    first = {job: done for job, done in made.items() if job.samples == 1}
    for job, each in slow.items():
        assert plan.expected_seconds(job, first) == pytest.approx(each * job.samples)
    assert plan.remaining_seconds(request, first) == pytest.approx(
        sum(each * job.samples for job, each in slow.items() if job not in first)
    )


def test_a_larger_reference_continues_a_smaller_one_in_few_images(plan):
    small, large = (plan.Request((), samples=samples).reference_jobs() for samples in (80, 65536))
    assert large[: len(small)] == small and len(large) < 150
    for half in range(2):
        assert sum(job.samples for job in large if job.seed % 2 == half) == 65536
    assert len({job.seed for job in large}) == len(large)


def test_a_given_reference_needs_no_cycles_and_failures_are_not_retried(plan, kept, choices):
    given, _, _ = run(plan, kept, plan.Request((kept.Job("mrpnn", 8),), largest=0, given=True))
    assert [job.method for job in given] == ["mrpnn"]
    request = plan.Request((), samples=1, largest=1)
    failed = {job for job in request.cycles_jobs() if job.method == choices.DENOISED}
    done = {job: None for job in request.cycles_jobs() if job not in failed}
    assert plan.next_job(request, done, failed) is None


def test_a_store_returns_what_it_was_given_and_ignores_damaged_files(kept, tmp_path, choices):
    store, job = kept.PassStore(tmp_path / "scene"), kept.Job(choices.DENOISED, 4, 1)
    assert store.get(job) is None
    image = np.random.default_rng(0).random((3, 5, 4)).astype(np.float32)
    store.put(job, kept.Pass(image, 2.0, 1.5, warnings=["left out"]))
    found = store.get(job)
    assert np.array_equal(found.image, image) and (found.seconds, found.cpu_seconds) == (2.0, 1.5)
    assert found.warnings == ["left out"] and store.get(kept.Job(choices.DENOISED, 4, 2)) is None
    (path,) = (tmp_path / "scene").iterdir()
    path.write_bytes(path.read_bytes()[:-40])
    assert store.get(job) is None


def test_the_key_differs_for_scenes_that_render_differently(addon, kept):
    from mrpnn.mrpnn_addon.scene.reader import SceneDescription

    from inference import Camera, Medium, Sun, Volume

    def key(density=1.0, albedo=0.9, anisotropy=0.5, sun=(0, 0, 1), size=8, moved=0.0, bounces=1024, frame=1):
        place = np.eye(4)
        place[0, 3] = moved
        volume = Volume(np.full((2, 2, 2), density, np.float32), place)
        return kept.scene_key(
            SceneDescription(
                [(volume, Medium(1.0, albedo, anisotropy))],
                [Sun(sun)],
                camera=Camera(place, resolution=(size, size)),
                frame=frame,
            ),
            bounces,
            "4.5",
        )

    keys = [
        key(),
        key(density=2.0),
        key(albedo=0.8),
        key(anisotropy=0.4),
        key(sun=(0, 1, 1)),
        key(size=9),
        key(moved=0.1),
        key(bounces=8),
        key(frame=2),
    ]
    assert len(set(keys)) == len(keys) and key() == keys[0]
