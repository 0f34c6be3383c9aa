"""Effects of operating modes, offsets and torque on positions and goals."""

from __future__ import annotations

import pytest

TURN = 6.283185307179586


def run(port, seconds):
    port.clock.sleep_until(port.clock.now_s() + seconds)


class TestDynamixelX:
    def test_x_velocity_mode_turns_at_goal_velocity(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("operating_mode", 1)
        servo.write("torque_enable", 1)
        servo.write("goal_velocity", -100)
        run(port, 2)
        assert servo.read("present_velocity") == pytest.approx(-100, abs=3)

    def test_x_pwm_mode_turns_at_speed_of_its_duty(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("operating_mode", 16)
        servo.write("torque_enable", 1)
        servo.write("goal_pwm", 443)
        run(port, 2)
        assert servo.read("present_pwm") == pytest.approx(443, abs=2)
        assert 60 < servo.read("present_velocity") < 110

    def test_x_current_mode_applies_goal_current(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("operating_mode", 0)
        servo.write("goal_current", 100)
        servo.motor.stuck = True
        servo.write("torque_enable", 1)
        run(port, 0.5)
        assert servo.read("present_current") == pytest.approx(100, abs=2)

    @pytest.mark.parametrize(("mode", "limited"), [(3, False), (4, False), (5, True)])
    def test_current_limit_acts_only_in_current_based_modes(self, make_port, mode, limited):
        servo = make_port("XL330-M288").line.servos[1]
        servo.write("operating_mode", mode)
        servo.write("current_limit", 500)
        servo.motor.stuck = True
        servo.write("torque_enable", 1)
        servo.write("goal_position", 4000)
        servo.motor.step(0.001, 0.0, servo.drive, 5.0)
        servo.motor.step(0.001, 0.0, servo.drive, 5.0)
        assert (servo.read("present_current") <= 500) is limited

    def test_extended_position_mode_moves_over_several_turns(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("operating_mode", 4)
        servo.write("torque_enable", 1)
        servo.write("goal_position", 6000)
        run(port, 4)
        assert servo.read("present_position") == pytest.approx(6000, abs=15)

    def test_mode_change_resets_profile_and_gains(self, make_port):
        servo = make_port("XM430-W350").line.servos[1]
        servo.write("profile_velocity", 50)
        servo.write("position_p_gain", 100)
        servo.write("operating_mode", 4)
        assert (servo.read("profile_velocity"), servo.read("position_p_gain")) == (0, 800)

    def test_mode_change_brings_position_into_one_turn(self, make_port):
        port = make_port("XM430-W350")
        port.line.world.place("servo_1", 2 * TURN)
        servo = port.line.servos[1]
        before = servo.read("present_position")
        servo.write("operating_mode", 4)
        assert (before, servo.read("present_position")) == (2048 + 8192, 2048)

    def test_torque_on_in_position_mode_wraps_position_to_one_turn(self, make_port):
        port = make_port("XM430-W350")
        port.line.world.place("servo_1", TURN)
        servo = port.line.servos[1]
        servo.write("torque_enable", 1)
        assert servo.read("present_position") == 2048

    @pytest.mark.parametrize(("mode", "offset", "seen"), [(3, 1024, 3072), (3, 1025, 2048),
                                                         (4, 5000, 7048)])  # fmt: skip
    def test_homing_offset_is_added_only_in_its_valid_range(self, make_port, mode, offset, seen):
        servo = make_port("XM430-W350").line.servos[1]
        servo.write("operating_mode", mode)
        servo.write("homing_offset", offset)
        assert servo.read("present_position") == seen

    def test_reverse_mode_servo_counts_in_other_direction(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("drive_mode", 1)
        port.line.world.place("servo_1", 0.25 * TURN)
        assert servo.read("present_position") % 4096 == 1024

    def test_reverse_mode_servo_reaches_its_goal(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("drive_mode", 1)
        servo.write("torque_enable", 1)
        servo.write("goal_position", 2500)
        run(port, 2)
        assert servo.read("present_position") == pytest.approx(2500, abs=8)

    def test_x_time_based_profile_takes_requested_duration(self, make_port):
        port = make_port("XM430-W350")
        servo = port.line.servos[1]
        servo.write("drive_mode", 4)
        servo.write("profile_velocity", 1000)
        servo.write("profile_acceleration", 250)
        servo.write("torque_enable", 1)
        servo.write("goal_position", 3048)
        run(port, 0.5)
        middle = servo.read("position_trajectory"), servo.read("moving_status") & 0x32
        run(port, 0.6)
        assert middle == (pytest.approx(2548, abs=5), 0x32)
        assert servo.read("position_trajectory") == 3048

    def test_drive_mode_8_switches_torque_on_by_goal_write(self, make_port):
        servo = make_port("XM430-W350").line.servos[1]
        servo.write("drive_mode", 8)
        servo.write("goal_position", 2100)
        assert servo.read("torque_enable") == 1

    def test_shutdown_lasts_until_reboot(self, make_port):
        servo = make_port("XM430-W350").line.servos[1]
        servo.write("torque_enable", 1)
        servo.inject_alarm(0x20)
        off = servo.read("torque_enable"), servo.write("torque_enable", 1) is None
        servo.reboot()
        assert (off, servo.write("torque_enable", 1)) == ((0, False), None)

    def test_startup_configuration_switches_torque_on(self, make_port):
        servo = make_port("XM430-W350").line.servos[1]
        servo.write("startup_configuration", 1)
        servo.reboot()
        assert servo.drive.torque_on

    def test_dynamixel_backup_restores_ram_at_boot(self, make_port):
        servo = make_port("XM430-W350").line.servos[1]
        servo.write("startup_configuration", 2)
        servo.write("profile_velocity", 77)
        servo.backup.store()
        servo.reboot()
        assert (servo.read("profile_velocity"), servo.read("backup_ready")) == (77, 1)


class TestFeetechSts:
    def test_sts_velocity_mode_turns_at_goal_speed(self, make_port):
        port = make_port("STS3215")
        servo = port.line.servos[1]
        servo.write("operating_mode", 1)
        servo.write("torque_enable", 1)
        servo.write("goal_speed", -800)
        run(port, 1)
        assert servo.read("present_speed") == pytest.approx(-800, abs=25)

    def test_sts_pwm_mode_takes_duty_from_goal_time_register(self, make_port):
        port = make_port("STS3215")
        servo = port.line.servos[1]
        servo.write("operating_mode", 2)
        servo.write("torque_enable", 1)
        servo.write("goal_time", -500)
        run(port, 1)
        assert servo.read("present_load") == pytest.approx(-500, abs=5)

    def test_sts_step_mode_adds_successive_goals(self, make_port):
        port = make_port("STS3215")
        servo = port.line.servos[1]
        servo.write("operating_mode", 3)
        servo.write("torque_enable", 1)
        servo.write("goal_position", 300)
        servo.write("goal_position", -100)
        run(port, 2)
        assert servo.read("present_position") == pytest.approx(2248, abs=3)

    def test_sts_damping_mode_does_not_hold_position(self, make_port):
        port = make_port("STS3215")
        servo = port.line.servos[1]
        servo.write("torque_enable", 2)
        servo.write("goal_position", 3000)
        run(port, 1)
        assert servo.read("present_position") == 2048

    def test_sts_goal_across_wrap_around_is_reached_the_long_way(self, make_port):
        port = make_port("STS3215")
        port.line.world.place("servo_1", 1900 / 4096 * TURN)  # tick 3948
        servo = port.line.servos[1]
        servo.write("torque_enable", 1)
        servo.write("goal_position", 100)
        run(port, 0.5)
        assert 500 < servo.read("present_position") < 3900

    def test_sts_limits_of_zero_allow_several_turns(self, make_port):
        port = make_port("STS3215")
        servo = port.line.servos[1]
        servo.write("phase", 12 | 16)
        servo.write("max_position_limit", 0)
        servo.write("torque_enable", 1)
        servo.write("goal_position", 7000)
        run(port, 4)
        assert servo.read("present_position") == pytest.approx(7000, abs=3)

    def test_sts_servo_moves_to_old_goal_at_torque_on(self, make_port):
        port = make_port("STS3215")
        port.line.world.place("servo_1", 0.5)
        servo = port.line.servos[1]
        servo.write("torque_enable", 1)
        run(port, 2)
        assert servo.read("present_position") == pytest.approx(2048, abs=3)

    def test_overload_limits_output_to_protective_torque(self, make_port):
        port = make_port("STS3215")
        servo = port.line.servos[1]
        servo.motor.stuck = True
        servo.write("torque_enable", 1)
        servo.write("goal_position", 3500)
        run(port, 1.9)
        before = servo.read("status"), servo.read("present_load")
        run(port, 0.3)
        assert before[0] == 0
        assert before[1] > 800
        assert (servo.read("status"), servo.read("present_load")) == (0x20, 200)

    def test_servo_alarm_bit_is_set_in_every_reply(self, make_port):
        port = make_port("STS3215")
        port.line.servos[1].inject_alarm(0x20)
        port.write(bytes.fromhex("FFFF0104023802BE"))
        assert port.read(8).hex() == "ffff010420 0008 d2".replace(" ", "")
