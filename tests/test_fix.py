"""Registers that outlast power are changed one by one, torque off, read back; a backup puts every one of them back."""

from contextlib import contextmanager

import pytest

from controller import load_rig
from controller.errors import InputError, RunError
from controller.families import family_of
from controller.products import PRODUCTS
from controller.registers import registers
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.open_bus import open_bus
from deploy.checks import check_servos
from deploy.commissioning.fix import apply_fixes, find_baud, read_backup, restoring
from deploy.commissioning.servo_backup import ServoBackup, load_backup, save_backup
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig

# what is wrong with each family's servos before: servo => register => count
WRONG = {
    "lamp-xc330": {
        1: {"return_delay_time": 250, "drive_mode": 1, "secondary_id": 9},
        2: {"min_position_limit": 2000, "homing_offset": 100},
        3: {"baud_rate": 1},
    },
    "lamp-ax12": {
        1: {"return_delay_time": 250},
        2: {"cw_angle_limit": 500, "ccw_angle_limit": 600},
        3: {"baud_rate": 34},
    },
    "lamp-sts3215": {
        1: {"return_delay": 250, "phase": 12 | 0x10},
        2: {"min_angle_limit": 2000, "p_coefficient": 7, "operating_mode": 1},
        3: {"baud_rate": 4},
    },
}


class Bench:
    """A virtual rig in lock step whose servos somebody has set up wrongly."""

    def __init__(self, name, bench):
        self.rig = load_rig(name)
        self.virtual = bench.rig
        self.bus = open_bus(LockstepPort(bench, self.rig.bus.baud), self.rig)
        self.family = self.rig.joints[0].family
        self.table = registers(self.rig.joints[0].product)
        self.wrong = WRONG[name]
        for servo, settings in self.wrong.items():
            if self.family.protocol == "feetech":
                self.bus.write_register(servo, self.table["lock"], 0)
            for register, count in settings.items():
                line = self.table[register]
                self.bus.write(servo, line.address, count.to_bytes(line.size, "little"))
        if self.family.protocol == "feetech":
            for servo in (1, 2):
                self.bus.write_register(servo, self.table["lock"], 1)

    def held(self, servo, register, baud=None):
        self.bus.port.setupPort(baud or self.rig.bus.baud)
        try:
            return self.bus.read_register(servo, self.table[register])
        finally:
            self.bus.port.setupPort(self.rig.bus.baud)

    def backups(self):
        joints = {joint.id: joint for joint in self.rig.joints}
        places = {1: self.rig.bus.baud, 2: self.rig.bus.baud}
        places[3] = find_baud(self.bus, self.rig, 3, joints[3].product) or self.rig.bus.baud
        return [read_backup(self.bus, self.rig, servo, joints[servo].product, baud) for servo, baud in places.items()]

    def fixes(self):
        found = [finding.fix for finding in check_servos(self.bus, self.rig)[1] if finding.fix]
        baud = next(value for value, rate in self.family.bauds.items() if rate == self.rig.bus.baud)
        return [*found, type(found[0])(3, "baud_rate", self.wrong[3]["baud_rate"], baud, "")]

    def errors(self):
        return [finding.text for finding in check_servos(self.bus, self.rig)[1] if finding.level == "error"]


@contextmanager
def bench_of(name):
    with LockstepBench(VirtualRig(load_rig(name))) as bench:
        made = Bench(name, bench)
        try:
            yield made
        finally:
            made.bus.close()


@pytest.mark.parametrize("name", WRONG)
def test_all_that_is_wrong_is_put_right_and_put_back(name, tmp_path):
    with bench_of(name) as bench:
        if bench.family.protocol == "feetech":
            bench.bus.write_register(1, bench.table["torque_enable"], 1)
        before = bench.backups()
        assert before[2].baud != bench.rig.bus.baud
        save_backup(tmp_path / "backup.json", name, before)
        fixes, made = bench.fixes(), []
        wrong = {(servo, register) for servo, settings in bench.wrong.items() for register in settings}
        assert {(fix.servo, fix.register) for fix in fixes} == wrong
        apply_fixes(bench.bus, bench.rig, before, fixes, made.append)
        assert made == sorted(fixes, key=lambda fix: fix.servo)
        assert bench.errors() == []
        assert [bench.held(servo, "torque_enable") for servo in (1, 2, 3)] == [0, 0, 0]
        # it outlasts power
        bench.virtual.set_faults([parse_fault(f"dead={servo}") for servo in (1, 2, 3)])
        bench.virtual.set_faults([])
        bench.bus.port.wait(bench.bus.port.now() + 1.0)
        assert bench.errors() == []

        now = bench.backups()
        back = [
            fix
            for old, new in zip(load_backup(tmp_path / "backup.json"), now, strict=True)
            for fix in restoring(old, new.values)
        ]
        assert {(fix.servo, fix.register, fix.want) for fix in back} == {
            (servo, register, count) for servo, settings in bench.wrong.items() for register, count in settings.items()
        }
        apply_fixes(bench.bus, bench.rig, now, back, lambda _: None)
        for servo, settings in bench.wrong.items():
            baud = before[2].baud if servo == 3 else None
            assert {register: bench.held(servo, register, baud) for register in settings} == settings


@pytest.mark.parametrize("name", WRONG)
def test_a_servo_that_falls_silent_half_way_costs_nothing(name):
    with bench_of(name) as bench:
        before = bench.backups()
        fixes, made = bench.fixes(), []

        def unplug_after_two(fix):
            made.append(fix)
            if len(made) == 2:
                bench.virtual.set_faults([parse_fault("dead=2"), parse_fault("dead=1")])

        with pytest.raises(RunError, match=rf"did not answer.*\(2 of {len(fixes)} changes were made before\)"):
            apply_fixes(bench.bus, bench.rig, before, fixes, unplug_after_two)
        bench.virtual.set_faults([])
        bench.bus.port.wait(bench.bus.port.now() + 1.0)
        now = bench.backups()
        back = [fix for old, new in zip(before, now, strict=True) for fix in restoring(old, new.values)]
        assert {(fix.servo, fix.register) for fix in back} == {(fix.servo, fix.register) for fix in made}
        apply_fixes(bench.bus, bench.rig, now, back, lambda _: None)
        again = bench.backups()
        assert not [fix for old, new in zip(before, again, strict=True) for fix in restoring(old, new.values)]


def test_a_feetech_servos_lock_is_closed_on_every_way_out():
    def interrupt(_):
        raise KeyboardInterrupt

    with bench_of("lamp-sts3215") as bench:
        with pytest.raises(KeyboardInterrupt):
            apply_fixes(bench.bus, bench.rig, bench.backups(), bench.fixes(), interrupt)
        assert bench.held(1, "lock") == 1
        apply_fixes(bench.bus, bench.rig, bench.backups(), bench.fixes(), lambda _: None)
        assert [bench.held(servo, "lock") for servo in (1, 2, 3)] == [1, 1, 1]


def test_the_lock_of_an_ax_servo_is_left_alone():
    with bench_of("lamp-ax12") as bench:
        apply_fixes(bench.bus, bench.rig, bench.backups(), bench.fixes(), lambda _: None)
        assert [bench.held(servo, "lock") for servo in (1, 2, 3)] == [0, 0, 0]


def test_a_backup_of_a_moved_servo_names_what_moves_it_back(tmp_path):
    file = tmp_path / "backup.json"
    save_backup(file, "xc330-m181", [ServoBackup(7, "xc330-m181", 57600, {"id": 7})])  # as `rig setup` keeps it
    with pytest.raises(InputError, match=r"rig setup PORT --product xc330-m181 --new-id 7 --new-baud 57600` puts it"):
        load_backup(file)


def test_a_backup_holds_every_register_and_is_never_overwritten(tmp_path):
    with bench_of("lamp-xc330") as bench:
        backup = bench.backups()[0]
    assert set(backup.values) == set(bench.table)
    file = tmp_path / "backup.json"
    save_backup(file, "lamp-xc330", [backup])
    assert load_backup(file) == (backup,)
    with pytest.raises(InputError, match="is there already; name another file"):
        save_backup(file, "lamp-xc330", [])
    assert load_backup(file) == (backup,)
    with pytest.raises(RunError, match="so nothing was changed"):
        save_backup(tmp_path / "no" / "backup.json", "lamp-xc330", [backup])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"format": 1', '"format": 2', "format 2 is not known"),
        ('"kind"', '"kin"', "is no backup of servos"),
        ('"xc330-m181"', '"xc330"', "was edited or damaged"),
        ('"id": 1,\n   "product"', '"id": 999,\n   "product"', "was edited or damaged"),
        ('"return_delay_time": ', '"return_delay_time": -0.', "was edited or damaged"),
        ('"return_delay_time"', '"delay"', "was edited or damaged"),
        ("}", "", "is no backup of servos"),
    ],
)
def test_a_damaged_backup_is_refused(tmp_path, old, new, expected):
    values = {name: register.initial for name, register in registers(PRODUCTS["xc330-m181"]).items()}
    file = tmp_path / "backup.json"
    save_backup(file, "r", [ServoBackup(1, "xc330-m181", 1_000_000, values)])
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=expected):
        load_backup(file)


def test_a_backup_of_another_servo_is_not_put_back():
    table = registers(PRODUCTS["xl330-m288"])
    values = {name: register.initial for name, register in table.items()}
    backup = ServoBackup(1, "xl330-m288", 1_000_000, values)
    assert restoring(backup, values) == []
    with pytest.raises(InputError, match="servo 1 is not the xl330-m288 of the backup"):
        restoring(backup, values | {family_of(PRODUCTS["xl330-m288"]).model_number: 1230})
