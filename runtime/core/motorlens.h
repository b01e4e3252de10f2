/* motorlens.h - a virtual sensor in C99: samples in, estimates with their deviation and quality out.
 *
 * The same steps, names and numbers as the Python packages `line` and `estimate` of the runtime, which are the readable
 * reference. No allocation, no globals: a sensor is constant tables, all that is remembered is one plain struct.
 *
 *     motorlens_state state;
 *     motorlens_start(&sensor, &state, 1000000);                 nanoseconds between samples: half as much again is a gap
 *     each sample:   word = motorlens_update(&sensor, &state, &sample);
 *     when wanted:   word = motorlens_evaluate(&sensor, &state, &sample, word, estimate, sigma);
 *
 * IEEE arithmetic and no contraction of products and sums (-ffp-contract=off) give the same bits on every machine.
 */
#ifndef MOTORLENS_H
#define MOTORLENS_H

#include <stddef.h>
#include <stdint.h>

#include "motorlens_config.h"

/* Reasons to trust an estimate less; 0 is good. As `quality.Quality`. */
enum {
    MOTORLENS_QUALITY_WARM_UP = 1,
    MOTORLENS_QUALITY_BRIDGED = 2,
    MOTORLENS_QUALITY_STALE = 4,
    MOTORLENS_QUALITY_SATURATED = 8,
    MOTORLENS_QUALITY_OUTSIDE_ENVELOPE = 16,
    MOTORLENS_QUALITY_NOT_FINITE = 32,
    MOTORLENS_QUALITY_RESTORED = 64,
    MOTORLENS_QUALITY_OVERLOAD = 128,
    MOTORLENS_QUALITY_SIMULATED = 256,
    MOTORLENS_QUALITY_BACKEND_MISMATCH = 512,
    MOTORLENS_QUALITY_STUCK = 1024,
    MOTORLENS_QUALITY_JUMP = 2048,
    MOTORLENS_QUALITY_ASSUMED_COLD = 4096,
    MOTORLENS_QUALITY_LINE_LOST = 8192,
    MOTORLENS_QUALITY_UNFORETOLD = 16384
};

/* One instant. `ambient_C` is NaN where it is not measured; `flags` are reasons that the source knows already. */
typedef struct {
    int64_t time_ns;
    motorlens_real voltage_V, current_A, ambient_C;
    uint32_t flags;
} motorlens_sample;

/* What the filters remember a signal as: with `MOTORLENS_SINGLE` a whole number in a unit of its own, see bank.c. */
#if MOTORLENS_SINGLE
typedef int64_t motorlens_signal;
#else
typedef double motorlens_signal;
#endif

/* ---- the sensor: constant tables --------------------------------------------------------------------------------- */

/* What of a sample is believed; derived from the envelope by `gate.Gate`. */
typedef struct {
    int64_t warm_up_ns, cold_ns, first_dt_ns, slowest_ns, fastest_ns;
    motorlens_real least_V, most_V, least_A, most_A;
    motorlens_real absurd_V, absurd_A, move_V, flowing_A, noise_A;
    motorlens_real slew_A_ns; /* a current cannot change faster; infinite where the inductance is not known */
    int32_t repeats, needs_ambient;
} motorlens_gate;

/* Signals are products of two of: 0 one, 1 voltage, 2 current, 3 back-EMF of the cold winding, 4 ambient. */
typedef struct {
    uint16_t signals, filters, features;
    const uint8_t *first, *second;   /* (signals) factors of each */
    const uint8_t *filter_signal;    /* (filters) which signal each filters */
#if MOTORLENS_SINGLE
    const float *per_ns;             /* (filters) 1 / tau */
    const float *units;              /* (signals) so many make 2^32 of what the filters count in */
#else
    const double *tau_s;             /* (filters) */
#endif
    const uint16_t *plus, *minus;    /* (features) columns: filters, signals, observer; minus 0xFFFF is none */
    motorlens_real resistance_ohm;
} motorlens_features;

/* Where the sensor was trained: the features' distance from their mean, of which z = L' (features - mean) has the length. The
 * network reads z in single precision, which features of such different size would not survive, and features - mean in double,
 * where a change of basis would cost more than it gains. */
#if MOTORLENS_SINGLE
typedef struct {
    const int64_t *mean;             /* (features), in the unit of the feature's signal */
    const uint8_t *shift;            /* (features) to the 32 bits in which its distance from the mean is kept */
    const double *observed_mean, *observed_scale; /* the same for each output of the observer */
    const int32_t *whitening;        /* as below, in whole numbers: three columns each from the diagonal of the first */
    const uint8_t *places;           /* (features) from sums with it to the 32 bits in which z is kept */
    const int8_t *unit;              /* (features) 2 to this of z; without whitening, of the distance from the mean */
    float limit;
    int32_t distrust;
} motorlens_envelope;
#else
typedef struct {
    const double *mean;              /* (features) */
    const motorlens_real *whitening; /* the lower triangle L: four columns each from the diagonal of the first; NULL is the
                                      * unit matrix */
    double limit;                    /* of the sum of squares of z; infinite is none */
    int32_t distrust;                /* the feature that is above 0 where the observer is not to be believed; -1 is none */
} motorlens_envelope;
#endif

enum {
    MOTORLENS_TANH, MOTORLENS_EXP, MOTORLENS_SQRT, MOTORLENS_CLIP, MOTORLENS_MUL, MOTORLENS_SIGMOID, MOTORLENS_RELU,
    MOTORLENS_SOFTPLUS, MOTORLENS_LOG, MOTORLENS_DIV, MOTORLENS_ABS, MOTORLENS_RECIPROCAL, MOTORLENS_MAX, MOTORLENS_MIN
};

#if MOTORLENS_SINGLE
/* What a step works on: `width` sums over columns in whole numbers and over real ones, see whole_network.c; or, where there are no
 * weights, the real columns from `real_start` on. */
typedef struct {
    const void *weights;       /* (width, columns) of 32 bits, or, where narrow, of 16 */
    const int8_t *units;       /* (width) 2 to this is what one of such a sum is worth */
    const float *real_weights; /* (width, reals) */
    MOTORLENS_COLUMN start, columns, real_start, reals;
    uint8_t narrow;
} motorlens_argument;

typedef struct {
    uint8_t function, width;
    const motorlens_argument *argument[2]; /* of a function of one, twice the same */
    float low, high;                       /* of MOTORLENS_CLIP */
} motorlens_step;

/* The folded core graph: columns are what it reads of the features, a one, and what the steps add. */
typedef struct {
    const motorlens_step *steps;
    uint16_t count, outputs;
    const motorlens_argument *estimate, *sigma;
} motorlens_network;
#else
/* What a step works on: the columns from `start` on, or, with weights, `width` sums over so many of them. */
typedef struct {
    const motorlens_real *weights; /* (width, columns) */
    uint16_t start, columns;
} motorlens_argument;

/* `width` new columns: a function of one or two arguments. */
typedef struct {
    uint8_t function, arguments; /* arguments 1; 2; 3 is two that are the same */
    uint16_t width;
    motorlens_argument argument[2];
    motorlens_real low, high; /* of MOTORLENS_CLIP */
} motorlens_step;

/* The folded core graph: columns are what it reads of the features, a one, and what the steps add. */
typedef struct {
    const motorlens_step *steps;
    uint16_t count, outputs;
    motorlens_argument estimate, sigma;
    const motorlens_real *offset; /* (outputs) constants of the estimate, added last */
} motorlens_network;
#endif

enum {
    MOTORLENS_OP_ADD, MOTORLENS_OP_SUB, MOTORLENS_OP_MUL, MOTORLENS_OP_DIV, MOTORLENS_OP_NEG, MOTORLENS_OP_POW,
    MOTORLENS_OP_SQRT, MOTORLENS_OP_EXP, MOTORLENS_OP_LOG, MOTORLENS_OP_TANH, MOTORLENS_OP_SIN, MOTORLENS_OP_COS,
    MOTORLENS_OP_ABS, MOTORLENS_OP_MAX, MOTORLENS_OP_MIN, MOTORLENS_OP_SIGN, MOTORLENS_OP_LE, MOTORLENS_OP_SELECT
};

/* One operation of a straight-line program. A register from `registers` on is a constant. */
typedef struct {
    uint8_t operation;
    MOTORLENS_REGISTER result, argument[3];
} motorlens_operation;

/* A straight-line program: its inputs are the first registers. */
typedef struct {
    const motorlens_operation *steps;
    const double *constants;
    const MOTORLENS_REGISTER *outputs;
    uint16_t count, registers, inputs, results;
} motorlens_program;

/* The physics observer; `size` 0 is none. Layout as in docs/sensor-file.md. */
typedef struct {
#if MOTORLENS_OPERATIONS
    motorlens_program accumulate, correct, read;
#endif
    uint16_t size, window, time, outputs;
#if MOTORLENS_OPERATIONS
    double full_s, ambient_C;
#endif
} motorlens_observer;

typedef struct {
    motorlens_gate gate;
    motorlens_features features;
    motorlens_envelope envelope;
    motorlens_network network;
    motorlens_observer observer;
} motorlens_sensor;

/* ---- what is remembered: may be copied, stored and put back ------------------------------------------------------ */

#define MOTORLENS_NEVER INT64_MAX

typedef struct {
    int64_t first_ns, last_ns, bridged_until_ns, count, current_since, first_move, dead_since;
    motorlens_real voltage_V, current_A, ambient_C;
    int32_t begun, remembered; /* whether a sample was used yet; whether the heat of an earlier run was there at the start */
} motorlens_gate_state;

/* The filters after `count` samples; see bank.c. The decay belongs to the step `dt_s`. */
#if MOTORLENS_SINGLE
typedef struct {
    int64_t value[MOTORLENS_FILTERS + MOTORLENS_SIGNALS]; /* of the filters, then the signals of the last sample */
    int64_t dt_ns;
    int32_t gain[MOTORLENS_FILTERS]; /* of 2^31, after a shift */
    uint8_t shift[MOTORLENS_FILTERS];
} motorlens_bank_state;
#else
typedef struct {
    int64_t count;
    double before[MOTORLENS_FILTERS], inside[MOTORLENS_FILTERS], reach[MOTORLENS_FILTERS];
    double dt_s, decay[MOTORLENS_FILTERS], gain[MOTORLENS_FILTERS];
} motorlens_bank_state;
#endif

typedef struct {
    motorlens_gate_state gate;
    motorlens_bank_state bank;
    double observer[MOTORLENS_OBSERVER];
    int64_t period_ns;
    int32_t failed; /* the observer began afresh at the last sample */
} motorlens_state;

/* ---- the sensor at work ------------------------------------------------------------------------------------------ */

/* A fresh state. */
void motorlens_start(const motorlens_sensor *sensor, motorlens_state *state, int64_t period_ns);

/* Take in a sample, whose numbers become those last believed where they are not used. Gives the quality word so far;
 * or MOTORLENS_BACKWARDS, and leaves everything as it was, where time runs backwards. */
uint32_t motorlens_update(const motorlens_sensor *sensor, motorlens_state *state, motorlens_sample *sample);
#define MOTORLENS_BACKWARDS UINT32_MAX

/* The estimates and one standard deviation of each (network.outputs) after the sample that `update` has taken; gives the
 * quality word. */
uint32_t motorlens_evaluate(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample,
                            uint32_t quality, motorlens_real *estimate, motorlens_real *sigma);

/* A number of each of some rows that are evaluated side by side. */
typedef motorlens_real motorlens_lanes[MOTORLENS_LANES];

#if !MOTORLENS_SINGLE
/* Many samples: n of each array (`ambient_C` and `flags` may be NULL), to be evaluated at the m indices `rows` in rising order
 * (NULL: all). Estimates and deviations are (outputs, m), quality words (m). `features` (looked, features) takes those of the
 * first `look_length` of each `look_every` samples since the start that are evaluated (0: of none), `looked` how many they were. */
typedef struct {
    int64_t n, m, look_every, look_length, looked;
    const int64_t *time_ns;
    const double *voltage_V, *current_A, *ambient_C;
    const uint32_t *flags;
    const int64_t *rows;
    double *estimate, *sigma;
    uint32_t *quality;
    double *features;
} motorlens_block;

/* All of them in one call. Gives 0, or the index from 1 of a sample at which time runs backwards, and leaves the state as it
 * was. */
int64_t motorlens_push(const motorlens_sensor *sensor, motorlens_state *state, motorlens_block *block);

/* What features are made of: filters, signals, outputs of the observer. */
#define MOTORLENS_KNOWN (MOTORLENS_FILTERS + MOTORLENS_SIGNALS + MOTORLENS_OBSERVER)

/* Estimates and deviations of `rows` rows of features side by side, an output `stride` numbers after the one before, and what is
 * added to their quality words. All lanes of the features are numbers, whatever `rows` is. */
void motorlens_evaluate_rows(const motorlens_sensor *sensor, const motorlens_lanes *features, int rows, int64_t stride,
                             double *estimate, double *sigma, uint32_t *quality);
#endif

/* ---- its parts --------------------------------------------------------------------------------------------------- */

uint32_t motorlens_gate_inspect(const motorlens_gate *gate, motorlens_gate_state *state, int64_t period_ns,
                                motorlens_sample *sample, int64_t *dt_ns, int *used);
#if MOTORLENS_SINGLE
void motorlens_bank_advance(const motorlens_features *map, motorlens_bank_state *state, int64_t dt_ns);
#else
void motorlens_bank_advance(const motorlens_features *map, motorlens_bank_state *state, int64_t dt_ns,
                            const motorlens_signal *signals);
#endif
void motorlens_signals(const motorlens_features *map, const motorlens_sample *sample, motorlens_signal *signals);
#if MOTORLENS_SINGLE
void motorlens_whitened(const motorlens_sensor *sensor, const motorlens_state *state, const double *observed, int32_t *wholes,
                        float *reals, float *squares);
float motorlens_expf_between(float x);
void motorlens_network_evaluate(const motorlens_sensor *sensor, int32_t *wholes, float *reals, float *estimate, float *sigma);
void motorlens_narrow_sums(const int16_t *weights, const int32_t *columns, int count, int64_t *sums, int wanted);
void motorlens_wide_sums(const int32_t *weights, const int32_t *columns, int count, int64_t *sums, int wanted);
#else
void motorlens_bank_values(const motorlens_features *map, const motorlens_bank_state *state, double *values);
void motorlens_features_of(const motorlens_features *map, const motorlens_lanes *known, motorlens_lanes *features);
void motorlens_whitened(const motorlens_envelope *envelope, int count, const motorlens_lanes *features,
                        motorlens_lanes *columns, double *squares);
void motorlens_network_evaluate(const motorlens_network *network, int features, motorlens_lanes *columns,
                                motorlens_lanes *estimate, motorlens_lanes *sigma);
#endif
int motorlens_program_run(const motorlens_program *program, const double *inputs, double *results);
int motorlens_observer_advance(const motorlens_observer *observer, double *state, const motorlens_sample *sample,
                               double dt_s);
int motorlens_observer_read(const motorlens_observer *observer, double *state, double ambient_C, double *outputs);
double motorlens_decay(double x);
double motorlens_exp(double x);
double motorlens_log(double x);

#endif
