# SPDX-License-Identifier: Apache-2.0
# A machine of three axes with ball screws behind LinuxCNC's motion. The encoders are on the motors: the controller sees
# nothing of what the screws do to the carriages.
loadrt {*}[lindex $::KINS(KINEMATICS) 0]
loadrt $::EMCMOT(EMCMOT) servo_period_nsec=$::EMCMOT(SERVO_PERIOD) num_joints=$::KINS(JOINTS)
loadrt sum2 names=x.pull,x.push,y.pull,y.push,z.pull,z.push
loadrt limit1 names=x.nut,y.nut,z.nut
addf motion-command-handler servo-thread
addf motion-controller servo-thread

# A carriage stays where it is until the screw has gone through its play, half of which is on either side.
foreach {axis joint} {x 0 y 1 z 2} {
    net $axis-motor joint.$joint.motor-pos-cmd => joint.$joint.motor-pos-fb $axis.pull.in0 $axis.push.in0
    setp $axis.pull.offset -$::SCREW($axis)
    setp $axis.push.offset $::SCREW($axis)
    net $axis-low $axis.pull.out => $axis.nut.min
    net $axis-high $axis.push.out => $axis.nut.max
    net $axis-carriage $axis.nut.out => $axis.nut.in
    foreach part {pull push nut} { addf $axis.$part servo-thread }
}

net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed
