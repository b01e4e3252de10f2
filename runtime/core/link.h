/* link.h - a line that speaks frames: bytes into frames, frames into samples with the device's time. As `framing` and `link`. */
#ifndef MOTORLENS_LINK_H
#define MOTORLENS_LINK_H

#include <stdint.h>

#define MOTORLENS_PROTOCOL 1
#define MOTORLENS_OVERHEAD 12 /* header and CRC */
#define MOTORLENS_MAX_PAYLOAD 240
#define MOTORLENS_MAX_BODY (MOTORLENS_MAX_PAYLOAD + MOTORLENS_OVERHEAD + 1)

enum { MOTORLENS_KIND_HELLO = 1, MOTORLENS_KIND_SAMPLES = 2, MOTORLENS_KIND_STATUS = 3 };
/* What the device says of a frame's samples. */
enum { MOTORLENS_SAYS_RESTART = 1, MOTORLENS_SAYS_SATURATED = 2, MOTORLENS_SAYS_OVERRUN = 4 };

/* One frame; `payload` points into the decoder, and is good until it is fed again. NULL is no frame. */
typedef struct {
    const uint8_t *payload;
    int32_t length;
    uint32_t t0_us;
    uint16_t sequence;
    uint8_t kind, flags;
} motorlens_frame;

/* Cuts a stream of bytes into frames; holds at most one unfinished. */
typedef struct {
    uint8_t body[MOTORLENS_MAX_BODY];
    int32_t length, overlong;
    uint32_t bad_frames;
} motorlens_decoder;

void motorlens_decoder_start(motorlens_decoder *decoder);

/* Take in bytes up to the end of a frame, or all; gives how many. `frame->payload` is NULL where there is none yet. */
int64_t motorlens_decoder_feed(motorlens_decoder *decoder, const uint8_t *data, int64_t size, motorlens_frame *frame);

/* What HELLO says of one quantity: value = (scale * code + offset) * factor + shift; at or beyond least or most it is at a rail. */
typedef struct {
    double scale, offset, factor, shift, least, most;
    int32_t index, used;
} motorlens_channel;

/* What HELLO says of the numbers in SAMPLES. */
typedef struct {
    motorlens_channel channel[3]; /* voltage, current, ambient */
    int32_t channels, schema, floats, rails_known;
    uint32_t flags; /* of every sample: simulated */
} motorlens_scaling;

/* Time from device stamps, as `link.Link` keeps it. */
typedef struct {
    int64_t anchor_ns, count;     /* the grid: where it begins, and samples since */
    int64_t numerator, step_ns;   /* the rate: `numerator` samples last `step_ns` */
    int64_t offset_ns, last_arrival_ns;
    int32_t started, restarted, sequence; /* sequence -1: none yet */
    int64_t samples, lost_samples, lost_frames, late_frames, unknown_frames, gaps, restarts, device_overruns;
} motorlens_clock;

typedef struct {
    motorlens_decoder decoder;
    motorlens_clock clock;
    motorlens_scaling scaling;
} motorlens_link;

/* Where samples go; `ambient_C` is filled only where it is measured. */
typedef struct {
    int64_t *time_ns;
    double *voltage_V, *current_A, *ambient_C;
    uint32_t *flags;
    int64_t room, count;
} motorlens_samples;

#define MOTORLENS_LARGEST_FRAME 120 /* samples that one frame can add, the one of rest before it included */

/* Take in bytes until all are taken, there is no room for another frame, or a frame comes that is not SAMPLES; gives how many.
 * That frame is `other`, `payload` NULL otherwise: it is the caller's to understand. */
int64_t motorlens_link_feed(motorlens_link *link, const uint8_t *data, int64_t size, int64_t now_ns,
                            motorlens_samples *samples, motorlens_frame *other);

#endif
