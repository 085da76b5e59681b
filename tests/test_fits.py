"""The studies' verdicts hold. Those on measured data are skipped where the data are missing."""

from fits import cascaded_tanks_base, emps_dry_friction, silverbox_hardening


def test_dry_friction_explains_the_drive(shared_data):
    emps_dry_friction.verdict(*emps_dry_friction.study(shared_data / "emps"))


def test_the_silverbox_hardens(shared_data):
    silverbox_hardening.verdict(*silverbox_hardening.study(shared_data / "silverbox"))


def test_torricelli_alone_does_not_carry_the_tanks(shared_data):
    cascaded_tanks_base.verdict(cascaded_tanks_base.study(shared_data / "cascaded_tanks"))
