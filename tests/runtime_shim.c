// The firmware's bus master and line reader as a shared library, with a HAL whose every function is a test's.

#include <stddef.h>

#include "sv_bus.h"
#include "sv_hal.h"
#include "sv_lines.h"
#include "sv_packets1.h"
#include "sv_packets2.h"

typedef struct {
  uint32_t (*now_us)(void);
  void (*wait)(uint32_t until_us);
  int32_t (*read)(int32_t line, uint8_t* data, int32_t size);
  int32_t (*write)(int32_t line, const uint8_t* data, int32_t size);
} shim_hal;

typedef struct {
  sv_rig rig;
  sv_joint joints[SV_JOINT_MAX];
  sv_sensor sensors[SV_SENSOR_MAX];
  sv_message messages[SV_MESSAGE_MAX];
  int32_t raw[SV_SENSOR_MAX];
  sv_bus bus;
  sv_lines lines;
  sv_reply replies[SV_JOINT_MAX];
} shim;

static shim_hal hal;

void shim_hooks(const shim_hal* hooks);
size_t shim_size(void);
void shim_open(shim* s, int32_t protocol, int32_t baud, int32_t return_delay_us, int32_t patience_us, int32_t fast,
               int32_t njoint, const uint8_t* ids);
const sv_reply* shim_replies(const shim* s);
int32_t shim_strays(const shim* s);
uint16_t shim_ping(shim* s, int32_t joint);
void shim_read(shim* s, int32_t joint, int32_t address, int32_t size, uint8_t* data);
void shim_write(shim* s, int32_t joint, int32_t address, const uint8_t* data, int32_t size);
void shim_sync_read(shim* s, int32_t address, int32_t size, uint8_t* data);
void shim_sync_write(shim* s, int32_t address, int32_t size, const uint8_t* data);
int32_t shim_read_register(shim* s, int32_t joint, int32_t address, int32_t size, int32_t encoding);
int32_t shim_write_register(shim* s, int32_t joint, int32_t address, int32_t size, int32_t encoding, int32_t count);
int32_t shim_decode(int32_t size, int32_t encoding, const uint8_t* data);
void shim_encode(int32_t size, int32_t encoding, int32_t count, uint8_t* data);
void shim_message(shim* s, char letter, int32_t width, int32_t latency_us);
void shim_sensor(shim* s, int32_t message, int32_t field);
void shim_feed(shim* s, const uint8_t* bytes, int32_t n, uint32_t now_us);
int32_t shim_raw(const shim* s, int32_t sensor);
int32_t shim_age_us(const shim* s, int32_t sensor, uint32_t now_us);
int32_t shim_stopped(const shim* s);

void sv_hal_init(void) {}
uint32_t sv_hal_now_us(void) { return hal.now_us(); }
void sv_hal_wait(uint32_t until_us) { hal.wait(until_us); }
int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) { return hal.read(line, data, size); }
int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) { return hal.write(line, data, size); }
uint32_t sv_hal_inputs(void) { return 0; }
void sv_hal_feed_watchdog(void) {}
int32_t sv_hal_reset_cause(void) { return SV_RESET_POWER; }

void shim_hooks(const shim_hal* hooks) { hal = *hooks; }

size_t shim_size(void) { return sizeof(shim); }

void shim_open(shim* s, int32_t protocol, int32_t baud, int32_t return_delay_us, int32_t patience_us, int32_t fast,
               int32_t njoint, const uint8_t* ids) {
  s->rig.protocol = protocol;
  s->rig.baud = baud;
  s->rig.return_delay_us = return_delay_us;
  s->rig.patience_us = patience_us;
  s->rig.fast_sync_read = (uint8_t)fast;
  s->rig.njoint = njoint;
  s->rig.joints = s->joints;
  for (int32_t i = 0; i < njoint; i++) {
    s->joints[i].id = ids[i];
  }
  sv_bus_init(&s->bus, &s->rig);
}

const sv_reply* shim_replies(const shim* s) { return s->replies; }

// what one joint has answered
static void shim_keep(shim* s, int32_t status) {
  s->replies[0] = s->bus.reply;
  s->replies[0].status = (uint8_t)status;
}

int32_t shim_strays(const shim* s) { return s->bus.strays; }

uint16_t shim_ping(shim* s, int32_t joint) {
  uint16_t model = 0;
  shim_keep(s, sv_bus_ping(&s->bus, joint, &model));
  return model;
}

void shim_read(shim* s, int32_t joint, int32_t address, int32_t size, uint8_t* data) {
  shim_keep(s, sv_bus_read(&s->bus, joint, address, size, data));
}

void shim_write(shim* s, int32_t joint, int32_t address, const uint8_t* data, int32_t size) {
  shim_keep(s, sv_bus_write(&s->bus, joint, address, data, size));
}

void shim_sync_read(shim* s, int32_t address, int32_t size, uint8_t* data) {
  sv_bus_sync_read(&s->bus, address, size, s->replies, data);
}

void shim_sync_write(shim* s, int32_t address, int32_t size, const uint8_t* data) {
  sv_bus_sync_write(&s->bus, address, size, data);
}

static sv_register shim_register(int32_t address, int32_t size, int32_t encoding) {
  const sv_register reg = {(uint16_t)address, (uint8_t)size, (uint8_t)encoding};
  return reg;
}

int32_t shim_read_register(shim* s, int32_t joint, int32_t address, int32_t size, int32_t encoding) {
  const sv_register reg = shim_register(address, size, encoding);
  int32_t count = 0;
  shim_keep(s, sv_bus_read_register(&s->bus, joint, &reg, 3, &count));
  return count;
}

int32_t shim_write_register(shim* s, int32_t joint, int32_t address, int32_t size, int32_t encoding, int32_t count) {
  const sv_register reg = shim_register(address, size, encoding);
  int32_t held = 0;
  shim_keep(s, sv_bus_write_register(&s->bus, joint, &reg, count, 3, &held));
  return held;
}

int32_t shim_decode(int32_t size, int32_t encoding, const uint8_t* data) {
  const sv_register reg = shim_register(0, size, encoding);
  return sv_register_decode(&reg, data);
}

void shim_encode(int32_t size, int32_t encoding, int32_t count, uint8_t* data) {
  const sv_register reg = shim_register(0, size, encoding);
  sv_register_encode(&reg, count, data);
}

void shim_message(shim* s, char letter, int32_t width, int32_t latency_us) {
  const sv_message message = {letter, (uint8_t)width, latency_us};
  s->messages[s->rig.nmessage++] = message;
  s->rig.messages = s->messages;
}

void shim_sensor(shim* s, int32_t message, int32_t field) {
  s->sensors[s->rig.nsensor].message = (uint8_t)message;
  s->sensors[s->rig.nsensor++].field = (uint8_t)field;
  s->rig.sensors = s->sensors;
}

void shim_feed(shim* s, const uint8_t* bytes, int32_t n, uint32_t now_us) {
  sv_lines_feed(&s->lines, &s->rig, bytes, n, now_us, s->raw);
}

int32_t shim_raw(const shim* s, int32_t sensor) { return s->raw[sensor]; }

int32_t shim_age_us(const shim* s, int32_t sensor, uint32_t now_us) {
  return sv_lines_age_us(&s->lines, &s->rig, sensor, now_us);
}

int32_t shim_stopped(const shim* s) { return s->lines.emergency_stop; }
