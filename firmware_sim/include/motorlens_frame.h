/* motorlens_frame.h - motorlens wire protocol v1 for a drive's firmware. C99, header only, no allocation.
 *
 * docs/wire-protocol.md describes the bytes. Typical use, with two int16 channels and ten instants a frame:
 *
 *     static motorlens_sender sender = {0};
 *     uint8_t wire[MOTORLENS_WIRE_MAX];
 *     int16_t codes[10 * 2];                       // voltage, current, voltage, current, ...
 *     size_t n = motorlens_samples_i16(&sender, wire, 1, t0_us, 0, codes, 10, 2);
 *     uart_write(wire, n);
 *
 * and at boot and every few seconds, piece by piece until it returns 0:
 *
 *     for (uint8_t piece = 0; (n = motorlens_hello(&sender, wire, t0_us, json, strlen(json), piece)) != 0; piece++)
 *         uart_write(wire, n);
 */
#ifndef MOTORLENS_FRAME_H
#define MOTORLENS_FRAME_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define MOTORLENS_VERSION 1
#define MOTORLENS_MAX_PAYLOAD 240
#define MOTORLENS_WIRE_MAX (8 + MOTORLENS_MAX_PAYLOAD + 4 + 2)
#define MOTORLENS_HELLO_PIECE (MOTORLENS_MAX_PAYLOAD - 2)

enum { MOTORLENS_HELLO = 1, MOTORLENS_SAMPLES = 2, MOTORLENS_STATUS = 3 };
enum { MOTORLENS_RESTART = 1, MOTORLENS_SATURATED = 2, MOTORLENS_OVERRUN = 4 };

typedef struct {
    uint16_t sequence; /* counts all frames */
} motorlens_sender;

/* CRC-32 of IEEE 802.3, four bits at a time: 64 bytes of table. */
static inline uint32_t motorlens_crc32(const uint8_t *data, size_t length)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t k = 0; k < length; k++) {
        crc ^= data[k];
        crc = table[crc & 15u] ^ (crc >> 4);
        crc = table[crc & 15u] ^ (crc >> 4);
    }
    return ~crc;
}

static inline void motorlens_put16(uint8_t *out, uint16_t value)
{
    out[0] = (uint8_t)value;
    out[1] = (uint8_t)(value >> 8);
}

static inline void motorlens_put32(uint8_t *out, uint32_t value)
{
    motorlens_put16(out, (uint16_t)value);
    motorlens_put16(out + 2, (uint16_t)(value >> 16));
}

/* Frame a payload into `wire` (MOTORLENS_WIRE_MAX bytes); returns the bytes to send, 0 if the payload is too long. */
static inline size_t motorlens_frame(motorlens_sender *sender, uint8_t *wire, uint8_t kind, uint8_t flags,
                                     uint32_t t0_us, const uint8_t *payload, size_t length)
{
    uint8_t body[8 + MOTORLENS_MAX_PAYLOAD + 4];
    size_t size = 8 + length, out = 1, code_at = 0;
    if (length > MOTORLENS_MAX_PAYLOAD)
        return 0;
    body[0] = kind;
    body[1] = (uint8_t)(MOTORLENS_VERSION << 4 | (flags & 0x0F));
    motorlens_put16(body + 2, sender->sequence++);
    motorlens_put32(body + 4, t0_us);
    memcpy(body + 8, payload, length);
    motorlens_put32(body + size, motorlens_crc32(body, size));
    size += 4;
    /* COBS; a frame this short never has 254 bytes without a zero */
    for (size_t k = 0; k < size; k++) {
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

/* `count` instants of `channels` int16 codes, interleaved; count * channels <= 119. */
static inline size_t motorlens_samples_i16(motorlens_sender *sender, uint8_t *wire, uint8_t schema, uint32_t t0_us,
                                           uint8_t flags, const int16_t *codes, uint8_t count, uint8_t channels)
{
    uint8_t payload[MOTORLENS_MAX_PAYLOAD];
    size_t values = (size_t)count * channels;
    if (values * 2 + 2 > MOTORLENS_MAX_PAYLOAD)
        return 0;
    payload[0] = schema;
    payload[1] = count;
    for (size_t k = 0; k < values; k++)
        motorlens_put16(payload + 2 + 2 * k, (uint16_t)codes[k]);
    return motorlens_frame(sender, wire, MOTORLENS_SAMPLES, flags, t0_us, payload, 2 + 2 * values);
}

/* `count` instants of `channels` float32 values, interleaved; count * channels <= 59. */
static inline size_t motorlens_samples_f32(motorlens_sender *sender, uint8_t *wire, uint8_t schema, uint32_t t0_us,
                                           uint8_t flags, const float *values, uint8_t count, uint8_t channels)
{
    uint8_t payload[MOTORLENS_MAX_PAYLOAD];
    size_t n = (size_t)count * channels;
    if (n * 4 + 2 > MOTORLENS_MAX_PAYLOAD)
        return 0;
    payload[0] = schema;
    payload[1] = count;
    for (size_t k = 0; k < n; k++) {
        uint32_t bits;
        memcpy(&bits, values + k, 4);
        motorlens_put32(payload + 2 + 4 * k, bits);
    }
    return motorlens_frame(sender, wire, MOTORLENS_SAMPLES, flags, t0_us, payload, 2 + 4 * n);
}

/* Piece number `piece` of the HELLO text; 0 when there is no such piece. */
static inline size_t motorlens_hello(motorlens_sender *sender, uint8_t *wire, uint32_t t0_us, const char *json,
                                     size_t length, uint8_t piece)
{
    uint8_t payload[MOTORLENS_MAX_PAYLOAD];
    size_t start = (size_t)piece * MOTORLENS_HELLO_PIECE, size;
    if (start >= length)
        return 0;
    size = length - start < MOTORLENS_HELLO_PIECE ? length - start : MOTORLENS_HELLO_PIECE;
    payload[0] = piece;
    payload[1] = (uint8_t)((length + MOTORLENS_HELLO_PIECE - 1) / MOTORLENS_HELLO_PIECE);
    memcpy(payload + 2, json + start, size);
    return motorlens_frame(sender, wire, MOTORLENS_HELLO, 0, t0_us, payload, 2 + size);
}

/* Counters since boot. */
static inline size_t motorlens_status(motorlens_sender *sender, uint8_t *wire, uint32_t t0_us, uint64_t uptime_us,
                                      uint32_t samples, uint32_t dropped, uint32_t saturated)
{
    uint8_t payload[20];
    motorlens_put32(payload, (uint32_t)uptime_us);
    motorlens_put32(payload + 4, (uint32_t)(uptime_us >> 32));
    motorlens_put32(payload + 8, samples);
    motorlens_put32(payload + 12, dropped);
    motorlens_put32(payload + 16, saturated);
    return motorlens_frame(sender, wire, MOTORLENS_STATUS, 0, t0_us, payload, sizeof payload);
}

#endif
