"""Every bad input and every fault that the service promises to bear, with the right answer and the tests that prove it.

``BAD_INPUTS`` and ``FAULTS`` are where to look something up: the tests themselves are elsewhere. Each is named by its
file below ``tests`` and its function, with the id of a parameter in brackets where one of many is meant. This module
keeps the names true: a test that is renamed or removed, or a row that nobody proves, fails here.

Answers are the HTTP status and the ``code`` of the problem; ``accept`` is 202. ``make`` and ``batch`` end with 4 for
what cannot be read, with 3 for what has no usable face and with 2 for options that cannot be, with the same codes.
"""

from __future__ import annotations

import ast
import re
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import pytest

TESTS = Path(__file__).parents[1]


class Promise(NamedTuple):
    """One row."""

    what: str
    answer: str
    tests: tuple[str, ...]


_API = "service/api/test_bad_inputs.py::"
_UNUSABLE = _API + "test_a_photo_that_cannot_be_used_is_refused_and_not_kept"
_NO_PHOTO = _API + "test_what_is_no_photo_is_refused_whatever_it_is_called"
_ACCEPTED = _API + "test_unusual_photos_are_taken"
_BODY = _API + "test_a_body_that_is_not_as_announced_is_refused"
_OPTIONS = _API + "test_options_that_cannot_be_are_named"
_GATE = "service/photo/test_gate.py::"
_COLOUR = "service/photo/test_colour.py::"
_SANDBOX = "service/photo/test_sandbox.py::"
_LINE = "service/api/test_protocol.py::"
_JOBS = "service/api/test_jobs.py::"
_TENANTS = "service/api/test_tenants.py::"
_PROBLEMS = "service/jobs/test_problems.py::test_a_photo_without_a_usable_face_ends_with_the_object_of_a_refusal"
_CHOICE = "service/face/test_choice.py::"
_FINDER = "service/face/test_finder.py::"
_REFUSALS = "end_to_end/test_refusals.py::"

BAD_INPUTS: dict[int, Promise] = {
    1: Promise("empty body, no file part", "400 missing-file", (f"{_BODY}[no body]", f"{_BODY}[no photo]")),
    2: Promise("zero-byte file", "422 empty-file", (f"{_UNUSABLE}[zero bytes]", _GATE + "test_empty_file")),
    3: Promise(
        "text, HTML, PDF, ZIP named .jpg",
        "415 unsupported-format",
        tuple(f"{_NO_PHOTO}[{name}]" for name in ("text", "html", "pdf", "zip")),
    ),
    4: Promise(
        "SVG, EPS and PostScript, PSD, TIFF, FITS, ICO, BMP; no helper program runs",
        "415 unsupported-format",
        (
            *(f"{_NO_PHOTO}[{name}]" for name in ("svg", "postscript", "psd", "tiff little", "fits", "ico", "bmp")),
            _SANDBOX + "test_no_program_runs_but_our_own_decoder",
        ),
    ),
    5: Promise(
        "EXR, HDR, floats, with NaN; NaN between stages",
        "415 unsupported-format; a job that meets NaN fails with 500 numeric-error",
        (
            *(f"{_NO_PHOTO}[{name}]" for name in ("openexr", "hdr", "float tiff with nan", "pfm with nan")),
            "service/runtime/test_networks.py::test_what_is_not_finite_stops_at_the_door",
            "service/jobs/test_runner.py::test_a_job_that_cannot_be_done_ends_with_a_problem[numeric-error]",
        ),
    ),
    6: Promise(
        "a photo whose part claims another type",
        "accept",
        (_API + "test_the_type_that_a_part_claims_does_not_matter",),
    ),
    7: Promise("a request that is neither a form nor an image", "415 unsupported-media-type", (f"{_BODY}[json]",)),
    8: Promise(
        "a form without boundary, with another one, cut off",
        "400 malformed-multipart",
        tuple(f"{_BODY}[{name}]" for name in ("no boundary", "empty boundary", "other boundary", "no end", "cut off")),
    ),
    9: Promise(
        "1500 parts, 2 MB of text, two photos",
        "400 too-many-parts, 400 part-too-large, 400 one-file-only, whatever the parts are called",
        tuple(
            f"{_BODY}[{name}]"
            for name in (
                "1500 parts",
                "parts twice",
                "2 MB of text",
                "2 MB of text in a strange part",
                "two photos",
                "two photos of two names",
                "two photos, the strange one first",
                "half a wish and nine parts",
            )
        ),
    ),
    10: Promise(
        "body over the limit, with its length",
        "413 too-large before it is read, connection closed",
        (_LINE + "test_a_body_over_the_limit_is_refused_before_it_is_read",),
    ),
    11: Promise(
        "body over the limit, in chunks",
        "413 too-large when the limit is passed, file gone",
        (_LINE + "test_a_chunked_body_over_the_limit_is_cut_off", f"{_UNUSABLE}[too many bytes]"),
    ),
    12: Promise(
        "negative or double Content-Length, or with Transfer-Encoding",
        "400 bad-request, connection closed",
        (_LINE + "test_two_meanings_are_no_meaning",),
    ),
    13: Promise(
        "slow heads and bodies, many lines of one address",
        "408 request-timeout or closed; 503 busy",
        tuple(
            _LINE + name
            for name in (
                "test_a_head_that_never_ends_is_given_up",
                "test_a_body_that_stops_is_given_up",
                "test_a_body_that_trickles_is_given_up",
                "test_one_address_may_have_so_many_connections",
                "test_slow_clients_do_not_hold_up_others",
            )
        ),
    ),
    14: Promise(
        "client leaves in the upload", "no job, no file", (_LINE + "test_a_client_that_leaves_leaves_nothing_behind",)
    ),
    15: Promise(
        "JPEG (PNG, WebP) cut at every 1 % of its length",
        "422 corrupt-image",
        (_GATE + "test_cut_at_every_percent", f"{_UNUSABLE}[cut jpeg]", f"{_UNUSABLE}[cut png]"),
    ),
    16: Promise(
        "flipped bits, ten thousand times",
        "422 or accept; never 5xx, never above the memory limit",
        (
            "service/photo/test_fuzz.py::test_ten_thousand_damaged_files",
            _SANDBOX + "test_memory_of_the_decoder_is_capped",
        ),
    ),
    17: Promise(
        "header of 65500 x 65500",
        "422 too-many-pixels within 0.1 s",
        (_GATE + "test_header_of_a_giant", f"{_UNUSABLE}[65500 x 65500]"),
    ),
    18: Promise(
        "PNG of 30000 x 30000 in 110 KB",
        "422 too-many-pixels without memory",
        (f"{_UNUSABLE}[png bomb]", _SANDBOX + "test_bomb_costs_the_calling_process_no_memory"),
    ),
    19: Promise(
        "zTXt, iTXt, iCCP bombs",
        "422 corrupt-image",
        (f"{_UNUSABLE}[text bomb]", f"{_UNUSABLE}[profile bomb]", _GATE + "test_packed_metadata_bombs"),
    ),
    20: Promise(
        "progressive JPEG of 600 scans",
        "422 too-complex",
        (f"{_UNUSABLE}[600 scans]", _GATE + "test_hundreds_of_scans"),
    ),
    21: Promise(
        "1 x 1, 32 x 32, 20000 x 10",
        "422 too-small, 422 bad-aspect",
        tuple(f"{_UNUSABLE}[{name}]" for name in ("1 x 1", "32 x 32", "20000 x 10")),
    ),
    22: Promise("CMYK and YCCK JPEG", "accept, right colours", (f"{_ACCEPTED}[cmyk]", _COLOUR + "test_four_inks")),
    23: Promise(
        "16-bit PNG",
        "accept, scaled to 8 bits",
        (f"{_ACCEPTED}[16 bits]", _COLOUR + "test_16_bits_are_rounded_not_clipped_and_not_chopped"),
    ),
    24: Promise(
        "palette, with transparency, 1 bit, grey with alpha",
        "accept, as RGB",
        (
            *(f"{_ACCEPTED}[{name}]" for name in ("palette", "1 bit", "grey and alpha")),
            _GATE + "test_palette",
            _GATE + "test_palette_with_transparency",
            _GATE + "test_grey_with_alpha",
        ),
    ),
    25: Promise(
        "transparent face",
        "accept on grey, warning transparent",
        (f"{_ACCEPTED}[alpha]", _GATE + "test_transparent_pixels_show_one_grey"),
    ),
    26: Promise(
        "grey photo",
        "accept, warning no-colour",
        (f"{_ACCEPTED}[grey]", _GATE + "test_grey_photo_keeps_its_pixels_and_says_so"),
    ),
    27: Promise(
        "animated GIF; WebP, PNG",
        "415 unsupported-format; 422 animated",
        (f"{_NO_PHOTO}[gif]", f"{_UNUSABLE}[animated webp]", f"{_UNUSABLE}[animated png]"),
    ),
    28: Promise(
        "several images in one file",
        "accept the first, warning extra-images-ignored",
        (f"{_ACCEPTED}[two images in one]", _GATE + "test_first_of_several_images_in_one_file"),
    ),
    29: Promise(
        "EXIF orientation 1 to 8",
        "accept, the same result",
        (
            f"{_ACCEPTED}[turned]",
            _GATE + "test_orientation_is_undone",
            _GATE + "test_orientation_of_jpeg_is_undone",
            "end_to_end/test_sample.py::test_a_turn_in_the_exif_data_changes_nothing_and_goes_no_further",
        ),
    ),
    30: Promise(
        "orientation 99, broken EXIF, XMP, GPS",
        "accept, ignored; metadata goes no further",
        (
            f"{_ACCEPTED}[turn 99]",
            f"{_ACCEPTED}[broken exif]",
            _GATE + "test_broken_exif_is_ignored",
            _GATE + "test_metadata_goes_no_further",
            _API + "test_metadata_of_the_photo_is_not_in_the_answers",
        ),
    ),
    31: Promise(
        "Display P3, Adobe RGB", "accept, as sRGB", (f"{_ACCEPTED}[display p3]", _COLOUR + "test_profile_to_srgb")
    ),
    32: Promise(
        "broken or huge colour profile",
        "accept, warning icc-ignored",
        (
            f"{_ACCEPTED}[broken profile]",
            _GATE + "test_broken_profile_is_ignored_with_a_warning",
            _GATE + "test_huge_profile_is_ignored_with_a_warning",
        ),
    ),
    33: Promise(
        "image that is a ZIP, a script or PHP too",
        "accept the image; what was sent is never given out",
        (
            f"{_ACCEPTED}[a zip behind]",
            _GATE + "test_polyglots_are_only_images",
            _JOBS + "test_the_photo_is_never_given_out",
        ),
    ),
    34: Promise(
        "file names ../../x, NUL, 5000 characters, bidi, CON",
        "accept, name ignored",
        (_API + "test_the_name_of_a_file_does_not_matter_and_comes_back_nowhere",),
    ),
    35: Promise(
        "names in the archive",
        "a fixed list, stored, read by a strict reader",
        (
            "service/archive/test_container.py::test_a_strict_reader_accepts_every_entry",
            "service/archive/test_container.py::test_no_other_name_gets_in",
            "service/archive/test_container.py::test_zip64_where_sizes_need_it",
        ),
    ),
    36: Promise(
        "no face",
        "422 no-face (the job ends failed with it)",
        (
            f"{_PROBLEMS}[no-face]",
            _JOBS + "test_a_job_that_failed_says_why",
            _REFUSALS + "test_a_photo_without_a_face",
            _FINDER + "test_the_rest_of_the_sample_has_no_face",
        ),
    ),
    37: Promise(
        "several faces",
        "422 multiple-faces with boxes, unless one is chosen",
        (
            f"{_PROBLEMS}[multiple-faces]",
            _REFUSALS + "test_two_faces_are_refused_with_their_boxes_until_one_is_chosen",
            _CHOICE + "test_a_choice_is_followed",
        ),
    ),
    38: Promise(
        "face too small, cut off, turned away, covered",
        "422 face-too-small, 422 face-cut-off, warnings extreme-pose, eyes-covered",
        (
            f"{_PROBLEMS}[face-too-small]",
            f"{_PROBLEMS}[face-cut-off]",
            _CHOICE + "test_thirty_pixels_are_too_few_and_forty_are_enough",
            _CHOICE + "test_half_outside_is_cut_off_and_a_rim_is_not",
            "service/face/fit/test_fit.py::test_yaw_75_is_said_to_be_extreme",
            _FINDER + "test_sunglasses_are_noticed",
        ),
    ),
    39: Promise(
        "black, white, one colour, noise",
        "422 no-face",
        (
            _FINDER + "test_a_flat_picture_has_no_face",
            _FINDER + "test_noise_has_no_face",
            _REFUSALS + "test_an_all_grey_image",
        ),
    ),
    40: Promise(
        "options: NaN, 1e309, negative, huge, unknown, deep",
        "422 malformed-options, usage or unknown-field, with a pointer",
        tuple(f"{_OPTIONS}[{name}]" for name in ("nan", "1e309", "negative", "huge", "deep", "deeper")),
    ),
    41: Promise(
        "image_url or any address",
        "422 unknown-field; nothing to fetch with",
        (
            f"{_BODY}[part image_url]",
            f"{_OPTIONS}[url]",
            f"{_OPTIONS}[image_url]",
            _API + "test_the_service_has_nothing_to_fetch_with",
        ),
    ),
    42: Promise(
        "job ../.., another tenant's, made up",
        "404 not-found, the same body",
        (_API + "test_what_is_not_there_is_not_there", _TENANTS + "test_nobody_sees_the_jobs_of_another"),
    ),
    43: Promise(
        "result asked for early, of a failed, an erased, an expired job",
        "409 not-ready, 409 no-result, 410 gone with the reason",
        (
            _JOBS + "test_a_result_that_is_not_there_yet_says_why",
            _JOBS + "test_erasing_leaves_nothing_but_the_word_gone",
            "service/api/test_quick.py::test_what_has_expired_says_so",
        ),
    ),
    44: Promise(
        "ranges: valid, 1000, reversed, beyond the end; If-Range",
        "206, 416 range-not-satisfiable",
        (
            _JOBS + "test_a_download_can_go_on",
            _JOBS + "test_a_range_that_is_not_there_is_refused",
            _JOBS + "test_ranges_and_caches_mind_the_content",
        ),
    ),
    45: Promise(
        "the same Idempotency-Key: same body, other body, a hundred at once",
        "202 of the same job, 422 key-reuse, one job",
        (
            _JOBS + "test_the_same_request_again_is_the_same_job",
            "service/jobs/test_store.py::test_a_key_makes_one_job_however_many_ask_at_once",
            "service/api/test_faults.py::test_a_job_goes_on_without_its_client_and_a_hundred_the_same_are_one",
        ),
    ),
    46: Promise(
        "queue full, quota, jobs a day",
        "429 queue-full, 429 quota, with Retry-After; nothing stored",
        (_TENANTS + "test_a_full_queue_takes_nothing_and_stores_nothing", _TENANTS + "test_a_quota_is_kept"),
    ),
    47: Promise(
        "disk below its reserve, shutting down, nothing loaded",
        "507 no-space, 503 draining; with damaged data files /readyz says 503 starting; without a "
        "worker photos wait in the queue; alive all the while",
        (
            _TENANTS + "test_the_reserve_of_the_disk_is_not_touched",
            _TENANTS + "test_a_server_that_shuts_down_takes_nothing",
            _TENANTS + "test_without_a_worker_the_server_is_ready",
        ),
    ),
    48: Promise(
        "HEAD, OPTIONS, TRACE, a foreign page, another Host",
        "405 method-not-allowed, no CORS, 400 bad-host",
        (
            _API + "test_other_methods_are_refused_with_those_that_are_allowed",
            _API + "test_a_foreign_page_gets_no_permission",
            _API + "test_another_host_name_is_refused",
        ),
    ),
}

_FAULTS_API = "service/api/test_faults.py::"
_FAULTS_JOBS = "service/jobs/test_faults.py::"
_RUNNER = "service/jobs/test_runner.py::"
_POINTS = "service/jobs/test_points.py::"
_RESTART = "service/jobs/test_restart.py::"
_MACHINE = "service/jobs/test_machine.py::"
_POSTGRES = "service/jobs/test_postgres.py::"
_S3 = "service/jobs/test_s3.py::"

FAULTS: tuple[Promise, ...] = (
    Promise(
        "SIGKILL of worker, job, server or everything, at every point",
        "every 202 ends in success or a clear failure, finished stages are not redone, the same bytes",
        (
            _POINTS + "test_a_worker_may_die_at_every_point_of_a_job",
            _POINTS + "test_a_server_may_die_at_every_point_of_an_upload",
            _RESTART + "test_after_a_kill_the_job_goes_on_after_its_last_stage",
            _RESTART + "test_nothing_is_lost_in_a_little_chaos",
        ),
    ),
    Promise(
        "power cut (order of flushing only: no machine was switched off)",
        "nothing is promised before it is on the disk",
        (
            _FAULTS_JOBS + "test_a_photo_is_on_the_disk_before_its_job_is",
            _FAULTS_JOBS + "test_an_archive_is_on_the_disk_before_its_owner_hears_of_it",
            _FAULTS_JOBS + "test_a_commit_is_on_the_disk",
        ),
    ),
    Promise(
        "disk full, no more files, input/output errors, a file system that turns read-only",
        "no 202; jobs wait or fail clean; database whole",
        (
            _MACHINE + "test_a_file_system_that_turns_read_only_costs_nothing_that_was_accepted",
            _FAULTS_API + "test_a_full_disk_takes_nothing_and_loses_nothing",
            _FAULTS_JOBS + "test_a_disk_that_fails_for_a_while_costs_a_job_nothing",
        ),
    ),
    Promise(
        "out of memory: limit of the process, limit of a cgroup",
        "tried once more with less, then out-of-memory; the server lives",
        (
            _MACHINE + "test_the_kernel_takes_the_job_and_not_the_server",
            _RUNNER + "test_memory_has_an_end",
            _RUNNER + "test_a_job_without_enough_memory_is_tried_once_more_with_less",
            "service/jobs/test_stages.py::test_a_job_that_gets_by_with_less_memory_makes_the_same_maps_and_says_so",
            "service/runtime/test_memory.py::test_a_library_without_memory_is_known_by_what_it_says",
        ),
    ),
    Promise(
        "data file changed, missing, another one",
        "not ready until it is whole; at run time model-corrupt",
        (
            _FAULTS_API + "test_a_damaged_data_file_is_found_before_any_photo_is_taken",
            "service/jobs/test_worker.py::test_the_end_of_a_job_raises_the_doubt",
        ),
    ),
    Promise(
        "photo that crashes native code",
        "three attempts, then crashed; others go on",
        (
            _RUNNER + "test_a_job_that_cannot_be_done_ends_with_a_problem[crashed]",
            _FAULTS_JOBS + "test_a_crash_of_one_photo_is_nothing_to_another",
        ),
    ),
    Promise(
        "endless loop",
        "out-of-time",
        (_RUNNER + "test_time_has_an_end", _FAULTS_API + "test_a_process_that_is_stopped_costs_only_time"),
    ),
    Promise(
        "client gone after the upload, in a download",
        "the job goes on; the download goes on by Range",
        (
            _FAULTS_API + "test_clients_that_leave_in_a_download_leave_nothing_behind",
            _FAULTS_API + "test_a_job_goes_on_without_its_client_and_a_hundred_the_same_are_one",
        ),
    ),
    Promise(
        "the same upload twice, after a lost 202",
        "one job",
        (
            _POINTS + "test_a_server_may_die_at_every_point_of_an_upload",
            _JOBS + "test_the_same_request_again_is_the_same_job",
        ),
    ),
    Promise(
        "the clock is set (for the processes of the server, not for the machine)",
        "no early end, no second run",
        (
            "service/jobs/test_clock.py::test_a_clock_that_is_set_does_not_move_deadlines",
            _MACHINE + "test_a_clock_that_is_set_by_a_day_under_a_running_server_costs_nothing",
            "service/jobs/test_worker.py::test_a_clock_that_is_set_forward_takes_no_jobs_from_the_living",
            "service/jobs/test_janitor.py::test_uploads_that_became_no_job_go_after_an_hour",
        ),
    ),
    Promise(
        "SIGTERM, a second one",
        "uploads end, jobs go on after the next start; at once",
        (
            _FAULTS_API + "test_an_upload_under_way_is_finished_when_the_server_is_told_to_end",
            _FAULTS_API + "test_a_second_signal_ends_it_at_once",
            _RESTART + "test_a_signal_ends_it_and_the_job_goes_on_after_the_next_start",
        ),
    ),
    Promise(
        "upgrade and way back with jobs at work (versions of the steps, not of an image)",
        "begun again, none stuck",
        (
            _POINTS + "test_a_job_at_work_outlives_an_upgrade_and_the_way_back",
            "service/jobs/test_janitor.py::test_jobs_of_an_older_version_begin_again",
            _POSTGRES + "test_two_versions_at_one_queue_leave_no_job_standing",
            _POSTGRES + "test_jobs_of_an_old_version_whose_worker_is_gone_are_adopted",
        ),
    ),
    Promise(
        "Postgres restarted, worker killed, worker frozen, slow line, split network",
        "waits, goes on, taken over, one result",
        (
            _RESTART + "test_nothing_is_lost_with_several_workers_on_postgres",
            _POSTGRES + "test_a_slow_line_and_a_split_network_cost_time_only",
        ),
    ),
    Promise(
        "two servers on a folder",
        "the second ends with 2",
        (_JOBS + "test_a_second_server_on_the_folder_refuses_to_start",),
    ),
    Promise(
        "files deleted under a job",
        "made again, or a clear failure",
        (
            _FAULTS_JOBS + "test_everything_that_a_job_wrote_may_be_deleted_under_it",
            _FAULTS_JOBS + "test_a_job_whose_photo_is_gone_fails_with_an_answer",
        ),
    ),
    Promise(
        "the S3 store is away: at an upload, in a job, at a download",
        "503, waited for, one result",
        (
            _S3 + "test_a_store_that_is_gone_is_a_clear_answer_and_no_loss",
            _S3 + "test_a_store_that_fails_in_the_middle_of_a_job_costs_time_only",
            _S3 + "test_a_photo_that_the_store_does_not_give_out_now_is_waited_for",
            _S3 + "test_a_store_that_stays_away_ends_the_worker_not_the_job",
            _POSTGRES + "test_a_job_goes_on_with_another_worker_and_what_lies_on_a_store",
        ),
    ),
    Promise(
        "nobody reads the log",
        "jobs do not mind",
        (
            _FAULTS_API + "test_jobs_do_not_mind_a_log_that_nobody_reads",
            "service/jobs/test_logs.py::test_a_log_that_is_closed_stops_nothing",
        ),
    ),
)
"""What could not be made here is said in brackets."""


def test_the_rows_are_all_there() -> None:
    assert list(BAD_INPUTS) == list(range(1, 49))
    assert len(FAULTS) == 17


@pytest.mark.parametrize("row", [*BAD_INPUTS.values(), *FAULTS], ids=lambda row: str(row.what))
def test_every_promise_has_its_tests(row: Promise) -> None:
    assert row.answer
    assert row.tests
    for name in row.tests:
        path, _, rest = name.partition("::")
        function, _, parameter = rest.removesuffix("]").partition("[")
        functions, words = _known(path)
        assert function in functions, f"{name}: there is no such test"
        assert not parameter or parameter in words, f"{name}: no parameter is called so"


def test_a_status_in_an_answer_is_one_of_http_and_a_code_has_its_words() -> None:
    """Whoever looks an answer up finds its page."""
    from service.api.problems import EXPLANATIONS
    from service.jobs.problems import TITLES

    codes = {*EXPLANATIONS, *TITLES}
    for row in BAD_INPUTS.values():
        for status, code in re.findall(r"(\d{3}) ([a-z]+(?:-[a-z]+)+|usage|animated|busy|gone|draining)", row.answer):
            assert 400 <= int(status) < 600
            assert code in codes, f"{row.what}: {code}"


@lru_cache
def _known(path: str) -> tuple[set[str], set[str]]:
    """Names of the functions of a module of tests, and its strings, with those of what it takes parameters from."""
    tree = ast.parse((TESTS / path).read_text("utf-8"))
    functions = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    shared = ast.parse((TESTS / "service/photo/badimages.py").read_text("utf-8"))
    nodes = (*ast.walk(tree), *ast.walk(shared))
    return functions, {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
