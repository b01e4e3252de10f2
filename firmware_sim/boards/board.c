/* Start-up, serial line, tick counter and end, for the MPS2 boards under QEMU. */
#include "board.h"

extern uint32_t data_start[], data_end[], data_load[], bss_start[], bss_end[], stack_bottom[], stack_top[];
int main(void);
void reset(void);

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u) /* bit 0: what is sent waits; bit 1: something has come */
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_DIVIDER REGISTER(0x40004010u)
#define INPUT_DATA REGISTER(0x40005000u)
#define INPUT_STATE REGISTER(0x40005004u)
#define INPUT_CONTROL REGISTER(0x40005008u)
#define INPUT_DIVIDER REGISTER(0x40005010u)
#define TICK_CONTROL REGISTER(0xE000E010u)
#define TICK_RELOAD REGISTER(0xE000E014u)
#define TICK_VALUE REGISTER(0xE000E018u)
#define COPROCESSORS REGISTER(0xE000ED88u)
#define PAINT 0xA5A5A5A5u

static void fault(void)
{
    board_print("fault\n");
    board_exit(1);
}

__attribute__((section(".vectors"), used)) static void *const vectors[16] = {
    stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault, (void *)fault};

/* Copies by itself: what the C library brings for it would be counted as the sensor's. */
__attribute__((optimize("no-tree-loop-distribute-patterns"))) void reset(void)
{
    uint32_t *from = data_load;
    for (uint32_t *to = data_start; to < data_end; to++)
        *to = *from++;
    for (uint32_t *to = bss_start; to < bss_end; to++)
        *to = 0;
#if defined(__ARM_FP)
    COPROCESSORS |= 0xFu << 20;
    __asm volatile("dsb\n isb");
#endif
    UART_DIVIDER = 16;
    UART_CONTROL = 1; /* sends */
    INPUT_DIVIDER = 16;
    INPUT_CONTROL = 2; /* receives */
    board_exit(main());
}

void board_put(uint8_t byte)
{
    while (UART_STATE & 1u)
        ;
    UART_DATA = byte;
}

int board_get_input(void)
{
    return INPUT_STATE & 2u ? (int)(INPUT_DATA & 0xFFu) : -1;
}

void board_print(const char *text)
{
    while (*text)
        board_put((uint8_t)*text++);
}

void board_print_hex(uint64_t value, int digits)
{
    while (digits--)
        board_put((uint8_t)"0123456789abcdef"[value >> 4 * digits & 15u]);
}

void board_print_number(uint32_t value)
{
    if (value >= 10)
        board_print_number(value / 10);
    board_put((uint8_t)('0' + value % 10));
}

void board_ticks_start(void)
{
    TICK_RELOAD = 0xFFFFFFu;
    TICK_VALUE = 0;
    TICK_CONTROL = 5; /* the processor's clock, no interrupt */
}

uint32_t board_ticks(void)
{
    return TICK_VALUE;
}

uint32_t board_ticks_between(uint32_t first, uint32_t last)
{
    return (first - last) & 0xFFFFFFu;
}

__attribute__((optimize("no-tree-loop-distribute-patterns"))) void board_stack_mark(void)
{
    const uint32_t *here; /* less what this function itself may still push */
    __asm volatile("mov %0, sp" : "=r"(here));
    for (uint32_t *at = stack_bottom; at < here - 64; at++)
        *at = PAINT;
}

uint32_t board_stack_used(void)
{
    const uint32_t *at = stack_bottom;
    while (at < stack_top && *at == PAINT)
        at++;
    return (uint32_t)((const uint8_t *)stack_top - (const uint8_t *)at);
}

void board_exit(int status)
{
    /* Semihosting: SYS_EXIT, "the application ended" or "a run-time error". */
    register uint32_t operation __asm("r0") = 0x18;
    register uint32_t reason __asm("r1") = status ? 0x20023u : 0x20026u;
    __asm volatile("bkpt 0xAB" : : "r"(operation), "r"(reason) : "memory");
    for (;;)
        ;
}
