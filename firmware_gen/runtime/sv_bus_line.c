#include "sv_bus_line.h"

#include "sv_hal.h"
#include "sv_time.h"

#define SV_WAIT_US_MAX 50000U   // without food for the watchdog
#define SV_NBYTE_MAX 16384      // of one stretch in which the line is busy
#define SV_FLUSH_MAX 256        // reads that a flush may take: no babbling line holds it up
#define SV_OVERDUE_US_MAX 2000  // how long after its deadline a transaction may still take what waits

// Return how long up to 40,000 bytes of 10 bits are on the line [us], rounded up: every rate is a multiple of 100
// bit/s.
static uint32_t sv_line_us(const sv_bus* bus, int32_t nbyte) {
  const uint32_t rate = (uint32_t)SV_RIG(bus)->baud / 100U;
  return ((uint32_t)nbyte * 100000U + rate - 1U) / rate;
}

// Forget the bytes that have left the line: what follows is on it from now on.
static void sv_clear_line(sv_bus* bus, uint32_t now_us) {
  if (now_us - bus->line_from_us >= sv_line_us(bus, bus->line_nbyte) || bus->line_nbyte > SV_NBYTE_MAX) {
    bus->line_from_us = now_us;
    bus->line_nbyte = 0;
  }
}

// Take what waits; return how many bytes.
static int32_t sv_read_line(sv_bus* bus) {
  const int32_t room = (int32_t)sizeof bus->received - bus->nreceived;
  const int32_t n = sv_hal_read(SV_LINE_BUS, bus->received + bus->nreceived, room);
  bus->nreceived += n;
  bus->nbyte += (uint32_t)n;
  return n;
}

// Drop every byte that waits: it answers nothing that will be asked now.
static void sv_flush(sv_bus* bus) {
  bus->nreceived = 0;
  for (int32_t i = 0; i < SV_FLUSH_MAX && sv_read_line(bus) > 0; i++) {
    bus->strays += bus->nreceived;
    bus->nreceived = 0;
  }
}

int32_t sv_bus_send(sv_bus* bus, int32_t nframe) {
  bus->nframe = nframe;
  sv_flush(bus);
  const uint32_t begin_us = sv_hal_now_us();
  if (nframe == 0 || sv_hal_write(SV_LINE_BUS, bus->frame, nframe) != nframe) {
    return 0;
  }
  bus->nbyte += (uint32_t)nframe;
  sv_clear_line(bus, begin_us);
  bus->line_nbyte += nframe;
  return 1;
}

void sv_bus_expect(sv_bus* bus, int32_t nbyte, int32_t nreply) {
  sv_clear_line(bus, sv_hal_now_us());
  bus->deadline_us = bus->line_from_us + sv_line_us(bus, bus->line_nbyte + nbyte);
  bus->deadline_us += (uint32_t)(nreply * SV_RIG(bus)->return_delay_us + bus->patience_us);
}

void sv_doze(uint32_t until_us) {
  const uint32_t now_us = sv_hal_now_us();
  sv_hal_wait(sv_has_come(now_us + SV_WAIT_US_MAX, until_us) ? until_us : now_us + SV_WAIT_US_MAX);
  // a clock that stands still is no reason to feed
  if (sv_hal_now_us() != now_us) {
    sv_hal_feed_watchdog();
  }
}

int32_t sv_bus_take(sv_bus* bus) {
  for (;;) {
    const uint32_t now_us = sv_hal_now_us();
    const int32_t left_us = (int32_t)(bus->deadline_us - now_us);
    // what has come by the deadline is taken after it, but a line that never falls silent is left alone
    if (bus->nreceived == (int32_t)sizeof bus->received || left_us <= -SV_OVERDUE_US_MAX) {
      return 0;
    }
    if (sv_read_line(bus) > 0) {
      return 1;
    }
    if (left_us <= 0) {
      return 0;
    }
    sv_doze(bus->deadline_us);
  }
}

void sv_bus_drop(sv_bus* bus, int32_t n) {
  for (int32_t i = n; i < bus->nreceived; i++) {
    bus->received[i - n] = bus->received[i];
  }
  bus->nreceived -= n;
}
