"""A stand-in for the PLC of compose.yaml: it answers each command with a wheel speed."""

from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock

cmd_vel = ReadBlock("/cmd_vel", prefix="cell1", stale_after=3.0)
wheel_speed = WriteBlock("/wheel_speed", prefix="cell1")
plc = VirtualPlc()


@plc.task("RosTask", interval=0.01).program
def drive() -> None:
    """PROGRAM drive."""
    wheel_speed.xEnable = cmd_vel() and wheel_speed.msg is not None
    if wheel_speed.xEnable:
        wheel_speed.msg.data = cmd_vel.msg.linear.x * 10
        print(f"/cmd_vel {cmd_vel.msg.linear.x} m/s, /wheel_speed {wheel_speed.msg.data}")
    wheel_speed()


plc.run()
