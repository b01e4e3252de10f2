/* fuzz_core.c - libFuzzer feeds bytes to the C core: to the line (frames, time, scaling), and what comes of them, with numbers of
 * the fuzzer's own, to gate, filters, observer and network. Built by benchmarks/fuzz_core.py beside an exported sensor, with the
 * address and undefined-behaviour sanitizers.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "link.h"
#include "sensor.h"
#if !MOTORLENS_SINGLE
#include "stream.h"
#endif

#define ROOM 512

static uint32_t crc32_of(const uint8_t *data, size_t length)
{
    uint32_t crc = 0xFFFFFFFFu;
    while (length--) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1u ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

/* A sound frame around the fuzzer's bytes, so that it gets past the CRC: kind, flags, sequence, clock and payload are its own. */
static size_t framed(const uint8_t *data, size_t size, uint8_t *wire)
{
    uint8_t body[8 + MOTORLENS_MAX_PAYLOAD + 4];
    size_t length = size < 8 ? 8 : size > 8 + MOTORLENS_MAX_PAYLOAD ? 8 + MOTORLENS_MAX_PAYLOAD : size, out = 1, code_at = 0;
    uint32_t crc;
    memset(body, 0, sizeof body);
    memcpy(body, data, size < length ? size : length);
    body[1] = (uint8_t)(MOTORLENS_PROTOCOL << 4 | (body[1] & 15u));
    crc = crc32_of(body, length);
    for (int k = 0; k < 4; k++)
        body[length++] = (uint8_t)(crc >> 8 * k);
    for (size_t k = 0; k < length; k++) {
        if (body[k] == 0) {
            wire[code_at] = (uint8_t)(out - code_at);
            code_at = out++;
        } else {
            wire[out++] = body[k];
        }
    }
    wire[code_at] = (uint8_t)(out - code_at);
    wire[out++] = 0;
    return out;
}

/* Gate, filters, observer and network on the first `most` samples. */
static void estimate(const motorlens_samples *samples, int64_t most)
{
    motorlens_real estimate[MOTORLENS_OUTPUTS], sigma[MOTORLENS_OUTPUTS];
    motorlens_state state;
    motorlens_start(&motor_sensor, &state, 1000000);
    for (int64_t k = 0; k < samples->count && k < most; k++) {
        motorlens_sample sample = {samples->time_ns[k], (motorlens_real)samples->voltage_V[k], (motorlens_real)samples->current_A[k],
                                   (motorlens_real)samples->ambient_C[k], samples->flags[k]};
        const uint32_t word = motorlens_update(&motor_sensor, &state, &sample);
        if (word == MOTORLENS_BACKWARDS)
            continue;
        if (k % 16 == 0)
            motorlens_evaluate(&motor_sensor, &state, &sample, word, estimate, sigma);
        for (int f = 0; f < motor_sensor.features.filters; f++) {
#if MOTORLENS_SINGLE
            if (state.bank.value[f] > INT64_C(1) << 61 || state.bank.value[f] < -(INT64_C(1) << 61))
                abort(); /* nothing beyond its unit reaches a filter */
#else
            if (!(state.bank.inside[f] - state.bank.inside[f] == 0.0))
                abort(); /* nothing that is not finite reaches a filter */
#endif
        }
    }
}

#if !MOTORLENS_SINGLE
/* The same bytes in one call from the line to estimates, with an instant of publishing every few samples or none. */
static void follow(motorlens_link *link, const uint8_t *data, int64_t size, int64_t instant_ns)
{
    static int64_t time_ns[ROOM], published_ns[ROOM], rows[ROOM];
    static double columns[3][ROOM], estimates[4][ROOM * MOTORLENS_OUTPUTS], inputs[2 * ROOM];
    static uint32_t flags[ROOM], words[ROOM];
    motorlens_state state;
    motorlens_stream stream;
    int64_t taken = 0;
    motorlens_start(&motor_sensor, &state, 1000000);
    memset(&stream, 0, sizeof stream);
    stream.link = link, stream.sensor = &motor_sensor, stream.state = &state;
    stream.samples.time_ns = time_ns, stream.samples.flags = flags, stream.samples.room = ROOM;
    stream.samples.voltage_V = columns[0], stream.samples.current_A = columns[1], stream.samples.ambient_C = columns[2];
    stream.block.time_ns = time_ns, stream.block.flags = flags, stream.block.quality = words;
    stream.block.voltage_V = columns[0], stream.block.current_A = columns[1];
    stream.block.estimate = estimates[0], stream.block.sigma = estimates[1];
    stream.values = estimates[2], stream.sigma = estimates[3], stream.inputs = inputs, stream.time_ns = published_ns;
    stream.rows = rows, stream.instant_ns = instant_ns, stream.instant = MOTORLENS_NO_INSTANT, stream.ambient_C = 20.0;
    while (taken < size) {
        taken += motorlens_stream_take(&stream, data + taken, size - taken, 1000000 * taken);
        if (stream.block.n > ROOM || stream.block.m > stream.block.n || (stream.backwards && stream.block.n))
            abort(); /* the line's time never runs backwards */
    }
}
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    int64_t time_ns[ROOM];
    double voltage_V[ROOM], current_A[ROOM], ambient_C[ROOM];
    uint32_t flags[ROOM];
    uint8_t wire[MOTORLENS_MAX_BODY + 1];
#if !MOTORLENS_SINGLE
    uint8_t line[4096];
    size_t heard = 0;
    motorlens_link fresh;
#endif
    motorlens_samples samples = {time_ns, voltage_V, current_A, ambient_C, flags, ROOM, 0};
    motorlens_link link;
    motorlens_frame other;
    int64_t taken = 0, now_ns = 0, most = 0;
    memset(&link, 0, sizeof link);
    motorlens_decoder_start(&link.decoder);
    link.clock.numerator = 1000;
    link.clock.step_ns = 1000000000;
    link.clock.sequence = -1;
    link.scaling.channels = 2;
    link.scaling.schema = 1;
    if (size > 0) {
        link.scaling.floats = data[0] & 1;
        link.scaling.rails_known = data[0] >> 1 & 1;
        /* All samples in one input of 16: with an observer a sample costs a hundred times what it costs the line. */
        most = data[0] >> 4 == 0 ? ROOM : 4;
        data++;
        size--;
    }
    for (int c = 0; c < 2; c++) {
        const motorlens_channel channel = {0.1, 0.0, 1.0, 0.0, -2048.0, 2047.0, c, 1};
        link.scaling.channel[c] = channel;
    }
#if !MOTORLENS_SINGLE
    fresh = link;
#endif
    /* Frames of its own, each led by its length, that are sound; then the bytes as they are. */
    while (size > 1 && samples.count + MOTORLENS_LARGEST_FRAME <= ROOM) {
        const size_t length = data[0] < size - 1 ? data[0] : size - 1, bytes = framed(data + 1, length, wire);
        for (taken = 0; taken < (int64_t)bytes && samples.count + MOTORLENS_LARGEST_FRAME <= ROOM;)
            taken += motorlens_link_feed(&link, wire + taken, (int64_t)bytes - taken, now_ns += 1000000, &samples, &other);
#if !MOTORLENS_SINGLE
        if (heard + bytes <= sizeof line) {
            memcpy(line + heard, wire, bytes);
            heard += bytes;
        }
#endif
        data += 1 + length;
        size -= 1 + length;
        if (length == 0)
            break;
    }
    for (taken = 0; taken < (int64_t)size && samples.count + MOTORLENS_LARGEST_FRAME <= ROOM;)
        taken += motorlens_link_feed(&link, data + taken, (int64_t)size - taken, now_ns += 1000000, &samples, &other);
    if (link.decoder.length > MOTORLENS_MAX_BODY || samples.count > ROOM)
        abort();
    estimate(&samples, most);
#if !MOTORLENS_SINGLE
    if (most == ROOM)
        follow(&fresh, line, (int64_t)heard, size & 1 ? 3000000 : 0);
#endif
    return 0;
}
