#include "sv_lines.h"

#include "sv_time.h"

#define SV_NO_CHANNEL 255
#define SV_SEQ_DIGITS 10
#define SV_TIME_DIGITS 16
#define SV_RAW_DIGITS 10
#define SV_DRIFT_PART 100U     // the node's clock runs slower or faster than ours by no more than this part of it
#define SV_MEMORY_US 1000000U  // how long a difference of the clocks is remembered
#define SV_SHARE_SHIFT 17      // differences in the same 2^17 us count as one

void sv_lines_init(sv_lines* lines, const sv_rig* rig) {
  lines->nopen = -1;
  lines->nchannel = 0;
  lines->emergency_stop = 0;
  for (int32_t i = 0; i < rig->nsensor; i++) {
    const sv_sensor* sensor = rig->sensors + i;
    int32_t place = 0;
    while (place < lines->nchannel && lines->channels[place].message != sensor->message) {
      place++;
    }
    lines->channel_of[i] = place < SV_MESSAGE_MAX ? (uint8_t)place : SV_NO_CHANNEL;
    if (place >= SV_MESSAGE_MAX) {
      continue;
    }
    sv_channel* channel = lines->channels + place;
    if (place == lines->nchannel) {
      lines->nchannel++;
      channel->message = sensor->message;
      channel->seen = 0;
      channel->width = 0;
      channel->ndifference = 0;
    }
    channel->latency_us = sensor->latency_us;
    channel->width = channel->width > sensor->field ? channel->width : (uint8_t)(sensor->field + 1);
  }
}

// what a line says

static int32_t sv_is_digit(uint8_t c) { return c >= '0' && c <= '9'; }

// Return a hexadecimal digit's value, -1: it is none.
static int32_t sv_hex(uint8_t c) {
  if (sv_is_digit(c)) {
    return c - '0';
  }
  const int32_t letter = (c | 0x20) - 'a';
  return letter >= 0 && letter < 6 ? 10 + letter : -1;
}

// What is left of a line to read.
typedef struct {
  const uint8_t* text;
  int32_t at;
  int32_t end;
} sv_rest;

static int32_t sv_skip(sv_rest* rest, uint8_t c) {
  const int32_t is = rest->at < rest->end && rest->text[rest->at] == c;
  rest->at += is;
  return is;
}

// Read 1..ndigit digits: => value; return whether there were as many.
static int32_t sv_number(sv_rest* rest, int32_t ndigit, uint64_t* value) {
  *value = 0;
  int32_t n = 0;
  while (n < ndigit && rest->at < rest->end && sv_is_digit(rest->text[rest->at])) {
    *value = 10 * *value + (uint64_t)(rest->text[rest->at] - '0');
    rest->at++;
    n++;
  }
  return n > 0;
}

// Read the next raw count: => count; return whether there was one.
static int32_t sv_count(sv_rest* rest, int32_t* count) {
  uint64_t value = 0;
  if (!sv_skip(rest, ',')) {
    return 0;
  }
  const int32_t negative = sv_skip(rest, '-');
  if (!sv_number(rest, SV_RAW_DIGITS, &value)) {
    return 0;
  }
  *count = (int32_t)(negative ? 0U - (uint32_t)value : (uint32_t)value);
  return value <= (uint32_t)INT32_MAX + (uint32_t)negative;
}

// Return whether a line is whole: it ends with * and the check of what is before it.
static int32_t sv_is_checked(const uint8_t* line, int32_t n) {
  if (n < 4 || line[n - 3] != '*' || sv_hex(line[n - 2]) < 0 || sv_hex(line[n - 1]) < 0) {
    return 0;
  }
  int32_t check = 0;
  for (int32_t i = 0; i < n - 3; i++) {
    check ^= line[i];
  }
  return check == sv_hex(line[n - 2]) * 16 + sv_hex(line[n - 1]);
}

// E, or E and a comma and anything that can be printed.
static int32_t sv_is_stop(const uint8_t* body, int32_t n) {
  for (int32_t i = 2; i < n; i++) {
    if (body[i] < ' ' || body[i] > '~' || body[i] == '*') {
      return 0;
    }
  }
  return body[0] == 'E' && (n == 1 || body[1] == ',');
}

// when its sample was taken

// Forget the differences that are older than a second.
static void sv_forget_old(sv_channel* channel, uint32_t now_us) {
  int32_t old = 0;
  if (now_us - channel->updated_us > SV_MEMORY_US) {
    old = channel->ndifference;
  }
  while (old < channel->ndifference && now_us - channel->differences[old].seen_us > SV_MEMORY_US) {
    old++;
  }
  for (int32_t i = old; i < channel->ndifference; i++) {
    channel->differences[i - old] = channel->differences[i];
  }
  channel->ndifference -= old;
}

// Add a difference above the offset that is seen now; larger ones that were seen before tell nothing any more.
static void sv_see(sv_channel* channel, int32_t above_us, uint32_t now_us) {
  const sv_difference newest = {now_us, above_us};
  while (channel->ndifference > 0 && channel->differences[channel->ndifference - 1].above_us >= above_us) {
    channel->ndifference--;
  }
  sv_difference* next = channel->differences + channel->ndifference;
  if (channel->ndifference == SV_WINDOW_MAX ||
      (channel->ndifference > 0 && next[-1].seen_us >> SV_SHARE_SHIFT == newest.seen_us >> SV_SHARE_SHIFT)) {
    next[-1].seen_us = newest.seen_us;
    return;
  }
  *next = newest;
  channel->ndifference++;
}

// Date a channel's new line; return whether it is another sample than the last.
static int32_t sv_date(sv_channel* channel, uint32_t t_us, uint32_t now_us) {
  const uint32_t difference_us = now_us - t_us - (uint32_t)channel->latency_us;
  if (channel->seen && t_us == channel->t_us) {
    return 0;
  }
  const int32_t starts = !channel->seen || (int32_t)(t_us - channel->t_us) < 0;
  // never above what was seen within a second: a smaller difference dates at once
  if (starts || (int32_t)(difference_us - channel->offset_us) < 0) {
    channel->offset_us = difference_us;
    channel->ndifference = 0;
  }
  const int32_t drift_us = starts ? 0 : (int32_t)((now_us - channel->updated_us) / SV_DRIFT_PART);
  sv_forget_old(channel, now_us);
  sv_see(channel, (int32_t)(difference_us - channel->offset_us), now_us);
  // a larger one than all of that second's can only come of clocks that drift apart
  const int32_t least_us = channel->differences[0].above_us;
  const int32_t grown_us = least_us < drift_us ? least_us : drift_us;
  channel->offset_us += (uint32_t)grown_us;
  for (int32_t i = 0; i < channel->ndifference; i++) {
    channel->differences[i].above_us -= grown_us;
  }
  channel->seen = 1;
  channel->t_us = t_us;
  channel->updated_us = now_us;
  return 1;
}

// Hold the counts of a line, (n), for its channel's sensors.
static void sv_hold(sv_lines* lines, const sv_rig* rig, int32_t place, sv_rest rest) {
  int32_t count = 0;
  for (int32_t field = 0; sv_count(&rest, &count); field++) {
    for (int32_t i = 0; i < rig->nsensor; i++) {
      if (lines->channel_of[i] == place && rig->sensors[i].field == field) {
        lines->raw[i] = count;
      }
    }
  }
}

// Take a whole line, from behind its $ to before its end.
static void sv_take_line(sv_lines* lines, const sv_rig* rig, uint32_t now_us) {
  const uint8_t* line = lines->open;
  if (!sv_is_checked(line, lines->nopen)) {
    return;
  }
  sv_rest rest = {line, 1, lines->nopen - 3};
  if (sv_is_stop(line, rest.end)) {
    lines->emergency_stop = 1;
    return;
  }
  uint64_t t_us = 0;
  if (!sv_skip(&rest, ',') || !sv_number(&rest, SV_SEQ_DIGITS, &t_us) || !sv_skip(&rest, ',') ||
      !sv_number(&rest, SV_TIME_DIGITS, &t_us)) {
    return;
  }
  const sv_rest counts = rest;
  int32_t ncount = 0;
  for (int32_t count = 0; sv_count(&rest, &count);) {
    ncount++;
  }
  for (int32_t place = 0; place < lines->nchannel && rest.at == rest.end; place++) {
    sv_channel* channel = lines->channels + place;
    if (channel->message == line[0] && ncount >= channel->width && sv_date(channel, (uint32_t)t_us, now_us)) {
      sv_hold(lines, rig, place, counts);
    }
  }
}

void sv_lines_feed(sv_lines* lines, const sv_rig* rig, const uint8_t* bytes, int32_t n, uint32_t now_us) {
  for (int32_t i = 0; i < n; i++) {
    if (bytes[i] == '$') {
      lines->nopen = 0;
    } else if (bytes[i] == '\r' || bytes[i] == '\n') {
      sv_take_line(lines, rig, now_us);
      lines->nopen = -1;
    } else if (lines->nopen >= SV_LINE_BYTES_MAX) {
      lines->nopen = -1;
    } else if (lines->nopen >= 0) {
      lines->open[lines->nopen++] = bytes[i];
    }
  }
}

int32_t sv_lines_raw(const sv_lines* lines, int32_t sensor, int32_t* raw) {
  const int32_t place = lines->channel_of[sensor];
  if (place >= lines->nchannel || !lines->channels[place].seen) {
    return 0;
  }
  *raw = lines->raw[sensor];
  return 1;
}

int32_t sv_lines_age_us(const sv_lines* lines, int32_t sensor, uint32_t now_us) {
  const int32_t place = lines->channel_of[sensor];
  return place < lines->nchannel && lines->channels[place].seen
             ? sv_age_us(now_us, lines->channels[place].t_us + lines->channels[place].offset_us)
             : -1;
}
