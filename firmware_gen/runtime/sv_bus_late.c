#include "sv_bus_late.h"

#include "sv_hal.h"

#define SV_LATE_US_MAX 250000U  // a reply that has not come by then will not come. An estimate.

void sv_bus_remember_late(sv_bus* bus, uint32_t joints, int32_t size) {
  const uint32_t now = sv_hal_now_us();
  int32_t kept = 0;
  // one entry for each joint and size: the newest
  for (int32_t i = 0; i < bus->nlate; i++) {
    sv_late entry = bus->late[i];
    entry.joints = (uint16_t)(entry.size == size ? entry.joints & ~joints : entry.joints);
    if (entry.joints != 0 && entry.until_us - now - 1U < SV_LATE_US_MAX) {
      bus->late[kept++] = entry;
    }
  }
  bus->nlate = kept;
  const sv_late lost = {(uint16_t)size, (uint16_t)joints, now + SV_LATE_US_MAX};
  if (bus->nlate < SV_LATE_MAX) {
    bus->late[bus->nlate++] = lost;
    return;
  }
  // no room: those that expire first join the newest of their size, or are forgotten
  int32_t place = 0;
  for (int32_t i = 1; i < bus->nlate; i++) {
    if (bus->late[i].size == size) {
      place = i;
    }
  }
  const uint16_t others = bus->late[place].size == size ? bus->late[place].joints : 0;
  bus->late[place] = lost;
  bus->late[place].joints = (uint16_t)(lost.joints | others);
}

// Return for how long a reply of `size` bytes of some joints may still come [us], 0: none can.
static uint32_t sv_late_for(const sv_bus* bus, uint32_t joints, int32_t size) {
  const uint32_t now = sv_hal_now_us();
  uint32_t longest = 0;
  for (int32_t i = 0; i < bus->nlate; i++) {
    const sv_late* entry = bus->late + i;
    const uint32_t left = entry->until_us - now;
    if (entry->size == size && (entry->joints & joints) != 0 && left - 1U < SV_LATE_US_MAX && left > longest) {
      longest = left;
    }
  }
  return longest;
}

int32_t sv_bus_unlike_late(const sv_bus* bus, uint32_t joints, int32_t size) {
  int32_t best = size;
  uint32_t least = UINT32_MAX;
  for (int32_t extra = 0; extra <= SV_EXTRA_MAX; extra++) {
    const uint32_t left = sv_late_for(bus, joints, size + extra);
    if (left < least) {
      least = left;
      best = size + extra;
    }
  }
  return best;
}
