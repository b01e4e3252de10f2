/* stream.h - one call from the bytes of a line to estimates, for a program that follows a drive. As `service.Service` does with
 * `link.Link` and `estimator.Estimator`. In double precision only: a board has samples of its own converter, and no line to decode.
 */
#ifndef MOTORLENS_STREAM_H
#define MOTORLENS_STREAM_H

#include "motorlens.h"
#include "link.h"

#define MOTORLENS_NO_INSTANT INT64_MIN

/* A line with the sensor that follows it, and where what comes of them goes: what was decoded into `samples`, which `block` reads,
 * and the m estimates. Its arrays have room for `samples.room`. */
typedef struct {
    motorlens_link *link;
    const motorlens_sensor *sensor;
    motorlens_state *state;
    motorlens_samples samples;
    motorlens_block block;
    motorlens_frame other; /* as `motorlens_link_feed` gives it */
    int64_t *rows;         /* those that are evaluated */
    double *values, *sigma, *inputs; /* estimates and deviations (m, outputs); voltage and current of those samples (m, 2) */
    int64_t *time_ns;      /* (m) */
    int64_t instant_ns;    /* the first sample at or after each multiple of this is evaluated; 0: all */
    int64_t instant;       /* the last multiple that was reached; MOTORLENS_NO_INSTANT: none yet */
    int64_t first_ns, newest_ns; /* of the samples that were estimated */
    int64_t late_ns;       /* a newest sample that was taken then or before has come too late: all that came are marked */
    int64_t backwards;     /* as `motorlens_push` gives it */
    double ambient_C;      /* where the line does not say it; NaN is not known */
} motorlens_stream;

/* Take in what one read of the line gave, and estimate. Gives how many bytes were taken. Where a frame came that is the caller's to
 * understand (`other`), or there was no room, nothing is estimated (`block.n` 0): the caller goes on with `samples`. */
int64_t motorlens_stream_take(motorlens_stream *stream, const uint8_t *data, int64_t size, int64_t now_ns);

#endif
