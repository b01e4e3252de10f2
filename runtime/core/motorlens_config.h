/* motorlens_config.h - what the core is compiled for. This one is for a PC: double precision, room for any sensor.
 * `motorlens export` writes one of its own beside the sensor's tables, with exactly the room that the sensor needs. */
#ifndef MOTORLENS_CONFIG_H
#define MOTORLENS_CONFIG_H

#define MOTORLENS_SINGLE 0 /* 1: single precision, and filters in whole numbers of 64 bits */
typedef double motorlens_real; /* of measurements and of the network; the observer computes in double everywhere */

/* So many rows are evaluated side by side, which a compiler turns into vector instructions; 1 on a microcontroller. */
#define MOTORLENS_LANES 16
#define MOTORLENS_FILTERS 96
#define MOTORLENS_FEATURES 128
#define MOTORLENS_SIGNALS 10
#define MOTORLENS_WIDTH 256 /* of the widest step of the network */
#define MOTORLENS_COLUMNS 1024 /* features, a one, and everything that the network computes */
#define MOTORLENS_OUTPUTS 8
#define MOTORLENS_OBSERVER 96
#define MOTORLENS_REGISTERS 1024
#define MOTORLENS_REGISTER uint16_t
#define MOTORLENS_FUNCTIONS 0x3FFFu /* of the network: a bit for each */
#define MOTORLENS_OPERATIONS 0x3FFFFu /* of the observer: a bit for each MOTORLENS_OP_ that it may have */
/* The observer's exp, log, pow, tanh, sin and cos are those of this machine's libm, as they are in Python. */
#define MOTORLENS_LIBM 1

#endif
