// The largest rig that the firmware has room for, and any kind; a generated project holds what its own rig is.

#ifndef SV_RIG_SIZES_H_
#define SV_RIG_SIZES_H_

#define SV_JOINT_MAX 16    // joints of a rig
#define SV_SENSOR_MAX 16   // channels of the sensor node
#define SV_MESSAGE_MAX 16  // letters that a rig's lines have
#define SV_BLOCK_MAX 160   // bytes of the longest block that is read at once
#define SV_FRAME_MAX 256   // bytes of the longest packet, stuffing included

// what a project knows of its rig costs no code for the other cases
#define SV_RIG(holder) ((holder)->rig)
#define SV_SET_RIG(holder, which) ((holder)->rig = (which))
#define SV_BAUD(rig) ((rig)->baud)
#define SV_SERVO(rig, joint) ((rig)->servos + (rig)->joints[joint].servo)
#define SV_PROTOCOL(rig) ((rig)->protocol)
#define SV_VELOCITY_MODE(rig) ((rig)->velocity_mode)
#define SV_FAST_SYNC_READ(rig) ((rig)->fast_sync_read)
#define SV_HAS_SIGN_BIT(reg) ((reg)->encoding > SV_TWOS)

#endif  // SV_RIG_SIZES_H_
