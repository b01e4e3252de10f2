/* From frames to samples: what they mean by HELLO, when each was taken by the device's clock, what was lost. As `link.Link`. */
#include <math.h>
#include <string.h>

#include "motorlens.h"
#include "link.h"

#define ON_GRID_NS 1500               /* stamps are whole microseconds; closer than this is on the grid */
#define RESTART_NS INT64_C(1000000000) /* a stamp this far in the past is a restarted clock, not a frame that comes late */
#define WRAP_NS (INT64_C(4294967296) * 1000)

/* Time of a sample by its number since the anchor, without a product that overflows. */
static int64_t time_ns_of(const motorlens_clock *clock, int64_t count)
{
    return clock->anchor_ns + count / clock->numerator * clock->step_ns +
           count % clock->numerator * clock->step_ns / clock->numerator;
}

/* How far a stamp is ahead of the time expected next. */
static int64_t ahead_ns(const motorlens_clock *clock, int64_t raw_ns)
{
    const int64_t apart = (raw_ns - clock->offset_ns - time_ns_of(clock, clock->count) + WRAP_NS / 2) % WRAP_NS;
    return (apart < 0 ? apart + WRAP_NS : apart) - WRAP_NS / 2;
}

/* Move the grid to where a frame says it is; whether the frame is of use. `rest_ns` is the time of a rest before it, if any. */
static int place(motorlens_clock *clock, uint32_t t0_us, int says_restart, int64_t now_ns, int64_t *rest_ns)
{
    const int64_t period_ns = clock->step_ns / clock->numerator, half_below = -(period_ns + 1) / 2;
    const int64_t raw_ns = (int64_t)t0_us * 1000;
    int64_t ahead;
    *rest_ns = INT64_MIN;
    if (!clock->started) {
        clock->started = 1;
        clock->anchor_ns = raw_ns;
        clock->count = 0;
        clock->offset_ns = 0;
        return 1;
    }
    ahead = ahead_ns(clock, raw_ns);
    if (clock->restarted || ahead < -RESTART_NS || (says_restart && ahead < half_below)) {
        const int64_t waited = now_ns - clock->last_arrival_ns, away_ns = waited > period_ns ? waited : period_ns;
        clock->restarted = 0;
        clock->restarts++;
        clock->anchor_ns = time_ns_of(clock, clock->count) - period_ns + away_ns;
        clock->count = 0;
        clock->offset_ns = raw_ns - clock->anchor_ns;
        /* Without power there is no voltage and no current: say so just before the first new sample. */
        if (away_ns >= 2 * period_ns)
            *rest_ns = clock->anchor_ns - period_ns;
        return 1;
    }
    if (ahead >= -ON_GRID_NS && ahead <= ON_GRID_NS)
        return 1;
    if (ahead < half_below) {
        clock->late_frames++;
        return 0;
    }
    clock->anchor_ns = time_ns_of(clock, clock->count) + ahead;
    clock->count = 0;
    if (ahead > period_ns / 2) {
        clock->gaps++;
        clock->lost_samples += (int64_t)rint((double)ahead / (double)period_ns);
    }
    return 1;
}

static double code_at(const motorlens_scaling *scaling, const uint8_t *row, int32_t index)
{
    if (scaling->floats) {
        const uint8_t *b = row + 4 * index;
        const uint32_t bits = (uint32_t)b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
        float value;
        memcpy(&value, &bits, sizeof value);
        return (double)value;
    }
    return (double)(int16_t)(uint16_t)(row[2 * index] | row[2 * index + 1] << 8);
}

static void add_sample(motorlens_samples *samples, int64_t time_ns, const double *values, uint32_t flags)
{
    const int64_t at = samples->count++;
    samples->time_ns[at] = time_ns;
    samples->voltage_V[at] = values[0];
    samples->current_A[at] = values[1];
    samples->ambient_C[at] = values[2];
    samples->flags[at] = flags;
}

static void take(motorlens_link *link, const motorlens_frame *frame, int64_t now_ns, motorlens_samples *samples)
{
    const motorlens_scaling *scaling = &link->scaling;
    motorlens_clock *clock = &link->clock;
    const int32_t width = scaling->channels * (scaling->floats ? 4 : 2);
    const uint8_t *row = frame->payload + 2;
    const int64_t first = samples->count;
    int64_t rest_ns;
    int32_t n;
    if (frame->length < 2 || frame->payload[0] != scaling->schema || (n = frame->payload[1]) == 0 ||
        n * width != frame->length - 2) {
        clock->unknown_frames++;
        return;
    }
    clock->device_overruns += (frame->flags & MOTORLENS_SAYS_OVERRUN) != 0;
    if (!place(clock, frame->t0_us, frame->flags & MOTORLENS_SAYS_RESTART, now_ns, &rest_ns)) {
        clock->last_arrival_ns = now_ns;
        return;
    }
    clock->last_arrival_ns = now_ns;
    if (rest_ns != INT64_MIN) {
        const double nothing[3] = {0.0, 0.0, 0.0};
        add_sample(samples, rest_ns, nothing, MOTORLENS_QUALITY_BRIDGED);
    }
    for (int32_t k = 0; k < n; k++, row += width) {
        double values[3] = {0.0, 0.0, 0.0};
        uint32_t flags = scaling->flags;
        for (int c = 0; c < 3; c++) {
            const motorlens_channel *channel = scaling->channel + c;
            if (channel->used) {
                const double code = code_at(scaling, row, channel->index);
                if (scaling->rails_known && (code <= channel->least || code >= channel->most))
                    flags |= MOTORLENS_QUALITY_SATURATED;
                values[c] = (code * channel->scale + channel->offset) * channel->factor + channel->shift;
            }
        }
        if (!scaling->rails_known && (frame->flags & MOTORLENS_SAYS_SATURATED))
            flags |= MOTORLENS_QUALITY_SATURATED;
        add_sample(samples, time_ns_of(clock, clock->count + k), values, flags);
    }
    if (rest_ns != INT64_MIN) /* what surrounds the motor is what it was */
        samples->ambient_C[first] = samples->ambient_C[first + 1];
    clock->count += n;
    clock->samples += n;
}

int64_t motorlens_link_feed(motorlens_link *link, const uint8_t *data, int64_t size, int64_t now_ns,
                            motorlens_samples *samples, motorlens_frame *other)
{
    motorlens_clock *clock = &link->clock;
    int64_t taken = 0;
    other->payload = NULL;
    while (taken < size && samples->count + MOTORLENS_LARGEST_FRAME <= samples->room) {
        motorlens_frame frame;
        taken += motorlens_decoder_feed(&link->decoder, data + taken, size - taken, &frame);
        if (frame.payload == NULL)
            continue;
        if (clock->sequence >= 0) {
            const int32_t step = (int32_t)(((uint32_t)frame.sequence - (uint32_t)clock->sequence) & 0xFFFFu);
            /* A step of more than half the range is a frame that comes late or twice, not 32768 lost ones. */
            clock->lost_frames += step > 1 && step < 0x8000 ? step - 1 : 0;
        }
        clock->sequence = frame.sequence;
        if (frame.kind != MOTORLENS_KIND_SAMPLES) {
            *other = frame;
            return taken;
        }
        take(link, &frame, now_ns, samples);
    }
    return taken;
}
