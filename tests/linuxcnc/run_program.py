#!/usr/bin/python3
"""LinuxCNC's user interface without a user: homes, sets the work offset, runs program.ngc, writes joints.txt, goes."""
import sys
import time

import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def complaint():
    message = errors.poll()
    if message:
        sys.exit(f"LinuxCNC: {message}")


def until(done, seconds, each=lambda: None):
    end = time.time() + seconds
    while time.time() < end:
        status.poll()
        each()
        if done():
            return
        complaint()
        time.sleep(0.002)
    sys.exit("LinuxCNC does not come to an end")


def mode(wanted):
    command.mode(wanted)
    command.wait_complete()


for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
    command.state(state)
    command.wait_complete()
mode(linuxcnc.MODE_MANUAL)
command.home(-1)
until(lambda: sum(status.homed[:5]) == 5, 60)
mode(linuxcnc.MODE_MDI)
command.mdi(open("zero.mdi").read().strip())
command.wait_complete()
mode(linuxcnc.MODE_AUTO)
command.program_open("program.ngc")
command.wait_complete()
command.auto(linuxcnc.AUTO_RUN, 0)
until(lambda: status.interp_state != linuxcnc.INTERP_IDLE, 60)

with open("joints.txt", "w") as joints:
    last = None

    def sample():
        global last
        row = (status.motion_line, *(f"{x:.7f}" for x in status.joint_position[:5]))
        if row != last:
            print(*row, file=joints)
        last = row

    until(lambda: status.interp_state == linuxcnc.INTERP_IDLE, 3600, sample)
print("the program has ended", flush=True)
