from ssm_pipeline.report.case_names import short_names


def test_short_ids_stay() -> None:
    assert short_names(["a", "hippocampus_003"]) == {"a": "a", "hippocampus_003": "hippocampus_003"}


def test_long_ids_keep_the_digits_that_tell_them_apart() -> None:
    ids = [f"1.3.6.1.4.1.14519.5.2.1.6279.6001.{number}" for number in ("1112345678", "2212345678")]
    assert short_names([*ids, "other"]) == {
        ids[0]: "…112345678",
        ids[1]: "…212345678",
        "other": "other",
    }


def test_the_part_that_tells_cases_apart_is_kept_wherever_it_stands() -> None:
    ids = [f"sub-{number:03d}_{'left-lung-segmentation-' * 2}v2" for number in (7, 112)]
    assert short_names(ids) == {ids[0]: "sub-007…", ids[1]: "sub-112…"}
    ids = [f"{'left-lung-of-patient-' * 2}{number}{'-segmentation' * 3}" for number in (7, 112)]
    assert short_names(ids) == {ids[0]: "…ient-7…", ids[1]: "…nt-112…"}


def test_a_long_id_does_not_shorten_the_others() -> None:
    ids = ["hippocampus_001", "hippocampus_003", f"{'copy_of_' * 5}hippocampus_001"]
    names = short_names(ids)
    assert [names[case_id] for case_id in ids[:2]] == ids[:2]
    assert len(names[ids[2]]) < 12
    assert len(set(names.values())) == 3


def test_one_long_id_is_cut() -> None:
    (name,) = short_names(["x" * 60]).values()
    assert len(name) < 12
