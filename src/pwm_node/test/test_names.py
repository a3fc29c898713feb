import pytest

from pwm_node.names import nearest, unknown


def test_says_the_nearest_name_and_all_there_are():
    sentence = unknown("scheme", "mbpc", ["mfpcc", "mbpcc"])
    assert sentence == "unknown scheme 'mbpc'; did you mean 'mbpcc'? There are: mbpcc, mfpcc"


def test_offers_nothing_where_nothing_is_near():
    assert unknown("motor", "xyz", ["seed_750"]) == "unknown motor 'xyz'. There are: seed_750"
    assert unknown("motor", "xyz", []) == "unknown motor 'xyz'. There are none"


def test_case_does_not_matter():
    assert nearest("SEED_750", ["seed_750", "ipmsm"]) == "seed_750"


SCHEMES = [
    "mbpcc", "mbpcc_single_vector", "mfpcc", "mfpcc_two_vector", "mls_mfpcc", "mls_mfpcc_paper",
    "neso_mfpcc", "pi_foc", "ultra_local_eso", "ultra_local_smo",
]  # fmt: skip


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("mls", "mls_mfpcc"),
        ("MLS-MFPCC", "mls_mfpcc"),
        ("paper", "mls_mfpcc_paper"),
        ("neso", "neso_mfpcc"),
        ("pi", "pi_foc"),
        ("FOC", "pi_foc"),
        ("smo", "ultra_local_smo"),
        ("ultra", "ultra_local_eso"),
        ("two_vector", "mfpcc_two_vector"),
        ("mfpc", "mfpcc"),
        ("mbpc", "mbpcc"),
        ("mls_mfpc", "mls_mfpcc"),
        ("msl_mfpcc", "mls_mfpcc"),
        ("deadbeat", None),
        ("x", None),
        ("", None),
    ],
)
def test_a_part_of_a_name_is_enough_to_tell_it(typed: str, meant: str | None):
    assert nearest(typed, SCHEMES) == meant


def test_another_name_for_it_comes_first():
    known = ["mismatch.flux", "mismatch.inductance", "mismatch.resistance"]
    also = {"mismatch.L_d": "mismatch.inductance", "mismatch.L": "mismatch.inductance"}
    assert nearest("mismatch.L", known, also) == "mismatch.inductance"
    assert nearest("mismatch.Ld", known, also) == "mismatch.inductance"
    # spelt most like mismatch.flux, which is not what is meant
    assert nearest("mismatch.L", known) == "mismatch.flux"
    assert nearest("mismatch.L", ["mismatch.flux"], also) == "mismatch.flux"
