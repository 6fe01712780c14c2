// The record, behind the code.
  .section .text.zz_record, "ax"
  .global replay_bus, replay_sensors, replay_console, replay_events
replay_bus:
  .incbin "record.bus"
replay_sensors:
  .incbin "record.sensors"
replay_console:
  .incbin "record.console"
replay_events:
  .incbin "record.events"
  .balign 4
