import os

from activefail.bearing.kernels import remove_stale_kernels, sources_digest


def package(folder, source_time, kernel_time):
    (folder / "__pycache__").mkdir(parents=True)
    for path, moment in (
        (folder / "contact.py", source_time),
        (folder / "__pycache__" / "contact.f-1.nbi", kernel_time),
        (folder / "__pycache__" / "contact.f-1.1.nbc", kernel_time),
    ):
        path.write_text("x")
        os.utime(path, (moment, moment))
    return folder


def test_kernels_older_than_a_source_are_removed(tmp_path):
    stale = package(tmp_path / "a", source_time=2000, kernel_time=1000)
    assert remove_stale_kernels(stale) == 2
    assert list((stale / "__pycache__").iterdir()) == []


def test_kernels_newer_than_all_sources_stay(tmp_path):
    fresh = package(tmp_path / "a", source_time=1000, kernel_time=2000)
    assert remove_stale_kernels(fresh) == 0
    assert len(list((fresh / "__pycache__").iterdir())) == 2


def test_a_package_without_kernels_is_left_alone(tmp_path):
    (tmp_path / "contact.py").write_text("x")
    assert remove_stale_kernels(tmp_path) == 0


def test_the_digest_changes_with_a_source(tmp_path):
    (tmp_path / "contact.py").write_text("x")
    before = sources_digest(tmp_path)
    (tmp_path / "contact.py").write_text("y")
    assert sources_digest(tmp_path) != before
