/* The physics observer: straight-line programs on a small register machine, as `observer.Observer` runs them in Python.
 *
 * Interpreted rather than printed as code: 721 operations in double take 3 to 7 kB as tables and four times that as Thumb code.
 * Where Python's arithmetic raises (division by zero, a logarithm of nothing, an overflow of exp), the program fails.
 */
#include "arithmetic.h"

#if MOTORLENS_OPERATIONS

#ifdef MOTORLENS_LIBM
#define observer_exp exp
#define observer_log log
#define observer_pow pow
#else
#define observer_exp motorlens_exp
#define observer_log motorlens_log
static double observer_pow(double x, double y)
{
    if (y == 0.0 || x == 1.0)
        return 1.0;
    if (x == 0.0)
        return y > 0.0 ? 0.0 : (double)INFINITY;
    return motorlens_exp(y * motorlens_log(x)); /* of what is not positive: NaN */
}
#endif

/* A sensor that has no sine brings none: which operations there are is known when it is compiled. */
#define HAS(operation) ((MOTORLENS_OPERATIONS >> (operation)) & 1u)

/* The value of an operation; `failed` where Python raises. */
static double applied(uint8_t operation, double a, double b, double c, int *failed)
{
    double result;
    switch (operation) {
    case MOTORLENS_OP_ADD: return a + b;
    case MOTORLENS_OP_SUB: return a - b;
    case MOTORLENS_OP_MUL: return a * b;
    case MOTORLENS_OP_DIV:
        *failed |= b == 0.0;
        return a / b;
    case MOTORLENS_OP_NEG: return -a;
    case MOTORLENS_OP_POW:
        result = HAS(MOTORLENS_OP_POW) ? observer_pow(a, b) : 0.0;
        *failed |= (isfinite(a) && isfinite(b) && !isfinite(result));
        return result;
    case MOTORLENS_OP_SQRT:
        *failed |= a < 0.0;
        return HAS(MOTORLENS_OP_SQRT) ? sqrt(a) : 0.0;
    case MOTORLENS_OP_EXP:
        result = HAS(MOTORLENS_OP_EXP) ? observer_exp(a) : 0.0;
        *failed |= isfinite(a) && isinf(result);
        return result;
    case MOTORLENS_OP_LOG:
        *failed |= a <= 0.0;
        return HAS(MOTORLENS_OP_LOG) ? observer_log(a) : 0.0;
    case MOTORLENS_OP_TANH: return HAS(MOTORLENS_OP_TANH) ? tanh(a) : 0.0;
    case MOTORLENS_OP_SIN:
        *failed |= isinf(a) != 0;
        return HAS(MOTORLENS_OP_SIN) ? sin(a) : 0.0;
    case MOTORLENS_OP_COS:
        *failed |= isinf(a) != 0;
        return HAS(MOTORLENS_OP_COS) ? cos(a) : 0.0;
    case MOTORLENS_OP_ABS: return fabs(a);
    case MOTORLENS_OP_MAX: return a >= b ? a : b;
    case MOTORLENS_OP_MIN: return a <= b ? a : b;
    case MOTORLENS_OP_SIGN: return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : 0.0;
    case MOTORLENS_OP_LE: return a <= b ? 1.0 : 0.0;
    default: return a != 0.0 ? b : c; /* MOTORLENS_OP_SELECT */
    }
}

int motorlens_program_run(const motorlens_program *program, const double *inputs, double *results)
{
    double registers[MOTORLENS_REGISTERS];
    const int count = program->registers;
    const double *constants = program->constants;
    int failed = 0;
    memcpy(registers, inputs, program->inputs * sizeof *inputs);
#define VALUE(index) ((index) < count ? registers[index] : constants[(index) - count])
    for (int s = 0; s < program->count; s++) {
        const motorlens_operation *step = program->steps + s;
        const double a = VALUE(step->argument[0]), b = VALUE(step->argument[1]);
        const double c = step->operation == MOTORLENS_OP_SELECT ? VALUE(step->argument[2]) : 0.0;
        registers[step->result] = applied(step->operation, a, b, c, &failed);
    }
    for (int k = 0; k < program->results; k++)
        results[k] = VALUE(program->outputs[k]);
#undef VALUE
    return failed;
}

int motorlens_observer_advance(const motorlens_observer *observer, double *state, const motorlens_sample *sample,
                               double dt_s)
{
    double inputs[MOTORLENS_OBSERVER + 4];
    int failed;
    const double ambient_C = isfinite(sample->ambient_C) ? (double)sample->ambient_C : observer->ambient_C;
    inputs[0] = (double)sample->voltage_V;
    inputs[1] = (double)sample->current_A;
    inputs[2] = ambient_C;
    inputs[3] = dt_s;
    memcpy(inputs + 4, state, observer->window * sizeof *state);
    failed = motorlens_program_run(&observer->accumulate, inputs, state);
    if (!failed && state[observer->time] >= observer->full_s) {
        double sum = 0.0;
        inputs[0] = ambient_C;
        memcpy(inputs + 1, state, observer->size * sizeof *state);
        failed = motorlens_program_run(&observer->correct, inputs, state);
        for (int k = 0; k < observer->size; k++)
            sum += state[k];
        failed |= !isfinite(sum);
    }
    if (failed)
        memset(state, 0, observer->size * sizeof *state);
    return failed;
}

int motorlens_observer_read(const motorlens_observer *observer, double *state, double ambient_C, double *outputs)
{
    double inputs[MOTORLENS_OBSERVER + 1];
    int failed;
    inputs[0] = isfinite(ambient_C) ? ambient_C : observer->ambient_C;
    memcpy(inputs + 1, state, observer->size * sizeof *state);
    failed = motorlens_program_run(&observer->read, inputs, outputs);
    if (failed)
        memset(state, 0, observer->size * sizeof *state);
    return failed;
}

#endif
