/* board.h - what the programs for the emulated boards use: a serial line, a count of instructions, the depth of the stack, an end. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* The serial lines: UART0 for what the board says, UART1 for what it is told. */
void board_put(uint8_t byte);
int board_get_input(void); /* -1 where nothing has come */
void board_print(const char *text);
void board_print_hex(uint64_t value, int digits);
void board_print_number(uint32_t value);

/* SysTick, that counts the processor's clock; the emulator takes one instruction for a nanosecond of it. */
#define BOARD_INSTRUCTIONS_PER_TICK 40u /* at 25 MHz */
void board_ticks_start(void);
uint32_t board_ticks(void); /* falls, modulo 2^24 */
uint32_t board_ticks_between(uint32_t first, uint32_t last);

/* Bytes of the stack that have been used so far, since `board_stack_mark`. */
void board_stack_mark(void);
uint32_t board_stack_used(void);

/* End the emulation with a status. */
void board_exit(int status);

#endif
