from pwm_node.names import nearest, unknown


def test_says_the_nearest_name_and_all_there_are():
    sentence = unknown("scheme", "mbpc", ["mfpcc", "mbpcc"])
    assert sentence == "unknown scheme 'mbpc'; did you mean 'mbpcc'? There are: mbpcc, mfpcc"


def test_offers_nothing_where_nothing_is_near():
    assert unknown("motor", "xyz", ["seed_750"]) == "unknown motor 'xyz'. There are: seed_750"
    assert unknown("motor", "xyz", []) == "unknown motor 'xyz'. There are none"


def test_case_does_not_matter():
    assert nearest("SEED_750", ["seed_750", "ipmsm"]) == "seed_750"
