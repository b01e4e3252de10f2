/* Wire protocol v1: bytes into frames, and back in step after whatever came. As `framing.Decoder`; docs/wire-protocol.md says
 * what a frame is. */
#include <string.h>

#include "motorlens.h"
#include "link.h"

/* CRC-32 of IEEE 802.3, four bits at a time: 64 bytes of table. */
static uint32_t crc32_of(const uint8_t *data, int32_t length)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};
    uint32_t crc = 0xFFFFFFFFu;
    while (length-- > 0) {
        crc ^= *data++;
        crc = table[crc & 15u] ^ crc >> 4;
        crc = table[crc & 15u] ^ crc >> 4;
    }
    return ~crc;
}

static uint32_t number_of(const uint8_t *bytes)
{
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

/* The frame in `body`, which is decoded in place; 0 if it is damaged, of another version, too short or too long. */
static int decode(uint8_t *body, int32_t length, motorlens_frame *frame)
{
    int32_t at = 0;
    if (length <= MOTORLENS_OVERHEAD || length > MOTORLENS_MAX_BODY)
        return 0;
    /* A code says where the next one stands; there, and that is all, a zero belongs. */
    while (at < length) {
        const uint8_t code = body[at];
        if (code == 0)
            return 0;
        body[at] = 0;
        at += code;
    }
    if (at != length || crc32_of(body + 1, length - 5) != number_of(body + length - 4) ||
        body[2] >> 4 != MOTORLENS_PROTOCOL)
        return 0;
    frame->kind = body[1];
    frame->flags = body[2] & 0x0Fu;
    frame->sequence = (uint16_t)(body[3] | body[4] << 8);
    frame->t0_us = number_of(body + 5);
    frame->payload = body + 9;
    frame->length = length - 13;
    return 1;
}

void motorlens_decoder_start(motorlens_decoder *decoder)
{
    memset(decoder, 0, sizeof *decoder);
}

int64_t motorlens_decoder_feed(motorlens_decoder *decoder, const uint8_t *data, int64_t size, motorlens_frame *frame)
{
    int64_t taken = 0;
    frame->payload = NULL;
    while (taken < size) {
        const uint8_t *zero = memchr(data + taken, 0, (size_t)(size - taken));
        const int64_t piece = (zero == NULL ? data + size : zero) - (data + taken);
        if (decoder->overlong || decoder->length + piece > MOTORLENS_MAX_BODY) {
            decoder->bad_frames += !decoder->overlong; /* what never ends must not fill the memory */
            decoder->overlong = 1;
            decoder->length = 0;
        } else {
            memcpy(decoder->body + decoder->length, data + taken, (size_t)piece);
            decoder->length += (int32_t)piece;
        }
        taken += piece;
        if (zero == NULL)
            break;
        taken++;
        if (!decoder->overlong && decoder->length > 0) {
            const int sound = decode(decoder->body, decoder->length, frame);
            decoder->length = 0;
            if (sound)
                return taken;
            decoder->bad_frames++;
        }
        decoder->length = 0;
        decoder->overlong = 0;
    }
    return taken;
}
