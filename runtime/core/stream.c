/* Bytes in, estimates out: framing, time, gate, filters, observer, network, intervals. */
#include "stream.h"

#if !MOTORLENS_SINGLE

/* Rounded down, as Python divides. */
static int64_t instant_of(int64_t time_ns, int64_t instant_ns)
{
    return time_ns / instant_ns - (time_ns % instant_ns < 0);
}

/* Which samples are to be evaluated; gives how many. As `outlet.Grid`. */
static int64_t choose(motorlens_stream *stream)
{
    int64_t chosen = 0;
    for (int64_t k = 0; k < stream->samples.count; k++) {
        const int64_t instant = instant_of(stream->samples.time_ns[k], stream->instant_ns);
        if (instant != stream->instant)
            stream->rows[chosen++] = k;
        stream->instant = instant;
    }
    return chosen;
}

/* What stands output by output, row by row. */
static void turn(const double *from, int64_t rows, int outputs, double *to)
{
    for (int64_t row = 0; row < rows; row++)
        for (int k = 0; k < outputs; k++)
            *to++ = from[k * rows + row];
}

/* The estimates as publishers take them, with the time of each and what was measured then. */
static void lay_out(motorlens_stream *stream)
{
    const motorlens_block *block = &stream->block;
    const motorlens_samples *samples = &stream->samples;
    turn(block->estimate, block->m, stream->sensor->network.outputs, stream->values);
    turn(block->sigma, block->m, stream->sensor->network.outputs, stream->sigma);
    for (int64_t row = 0; row < block->m; row++) {
        const int64_t at = block->rows == NULL ? row : block->rows[row];
        stream->time_ns[row] = samples->time_ns[at];
        stream->inputs[2 * row] = samples->voltage_V[at];
        stream->inputs[2 * row + 1] = samples->current_A[at];
    }
}

int64_t motorlens_stream_take(motorlens_stream *stream, const uint8_t *data, int64_t size, int64_t now_ns)
{
    motorlens_samples *samples = &stream->samples;
    motorlens_block *block = &stream->block;
    const int says_ambient = stream->link->scaling.channel[2].used;
    int64_t taken;
    samples->count = block->n = block->m = 0;
    taken = motorlens_link_feed(stream->link, data, size, now_ns, samples, &stream->other);
    if (taken < size || stream->other.payload != NULL || samples->count == 0)
        return taken;
    block->n = samples->count;
    block->m = stream->instant_ns == 0 ? samples->count : choose(stream);
    block->rows = stream->instant_ns == 0 ? NULL : stream->rows;
    block->ambient_C = says_ambient || stream->ambient_C == stream->ambient_C ? samples->ambient_C : NULL;
    for (int64_t k = 0; !says_ambient && k < samples->count; k++)
        samples->ambient_C[k] = stream->ambient_C;
    stream->first_ns = samples->time_ns[0];
    stream->newest_ns = samples->time_ns[samples->count - 1];
    if (stream->newest_ns <= stream->late_ns)
        for (int64_t k = 0; k < samples->count; k++)
            samples->flags[k] |= MOTORLENS_QUALITY_OVERLOAD;
    stream->backwards = motorlens_push(stream->sensor, stream->state, block);
    if (stream->backwards == 0)
        lay_out(stream);
    return taken;
}

#endif
