/* Numbers from a table of decimal text, as `decimal_text.read` and with the results of Python's float. Only for a PC: it asks
 * the C library for numbers of more digits than a double holds. */
#include <locale.h>
#include <stdint.h>
#include <stdlib.h>

int64_t motorlens_decimal_table(const char *text, int64_t size, int32_t columns, char separator, const int32_t *places,
                                int64_t room, double *out);

#define MOST_DIGITS 19                         /* a whole number of 64 bits holds them */
#define MOST_EXACT (UINT64_C(1) << 53)         /* up to here every whole number is a double */
#define MOST_POWER 22                          /* and every power of ten */

static int is_digit(char byte)
{
    return byte >= '0' && byte <= '9';
}

/* The number that begins at `at`, and where it ends; NULL where there is none. One rounding, of exact numbers (Clinger, PLDI
 * 1990); where they are not, the C library's, which rounds correctly as well. */
static const char *number_at(const char *at, double *value)
{
    static const double tens[MOST_POWER + 1] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                                1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    const char *const begin = at;
    const int negative = *at == '-';
    uint64_t mantissa = 0;
    int32_t digits = 0, decimals = 0, power = 0;
    at += negative;
    for (; is_digit(*at); at++, digits++)
        mantissa = 10 * mantissa + (uint64_t)(*at - '0'); /* beyond the most digits it is not used */
    if (*at == '.')
        for (at++; is_digit(*at); at++, decimals++)
            mantissa = 10 * mantissa + (uint64_t)(*at - '0');
    digits += decimals;
    if (digits == 0)
        return NULL;
    if (*at == 'e' || *at == 'E') {
        const int below = *++at == '-';
        at += *at == '-' || *at == '+';
        if (!is_digit(*at))
            return NULL;
        for (; is_digit(*at); at++)
            power = power < 100000 ? 10 * power + (*at - '0') : power;
        power = below ? -power : power;
    }
    power -= decimals;
    if (digits > MOST_DIGITS || mantissa > MOST_EXACT || power < -MOST_POWER || power > MOST_POWER) {
        *value = strtod(begin, NULL);
        return at;
    }
    *value = power < 0 ? (double)mantissa / tens[-power] : (double)mantissa * tens[power];
    if (negative)
        *value = -*value;
    return at;
}

/* Lines of `columns` cells each, `size` bytes that end with a newline: column c goes to row places[c] of `out` (rows, room), and
 * is not looked at where that is below 0. Gives how many lines, or -1 where a line has another number of cells, a cell is not
 * a plain number, or there are more lines than `room`. */
int64_t motorlens_decimal_table(const char *text, int64_t size, int32_t columns, char separator, const int32_t *places,
                                int64_t room, double *out)
{
    const char *at = text, *const end = text + size;
    int64_t row = 0;
    if (size < 1 || end[-1] != '\n' || *localeconv()->decimal_point != '.')
        return -1;
    for (; at < end; row++) {
        if (row == room)
            return -1;
        for (int32_t column = 0; column < columns; column++) {
            if (places[column] >= 0) {
                at = number_at(at, out + places[column] * room + row);
                if (at == NULL)
                    return -1;
            } else {
                while (*at != separator && *at != '\n') {
                    if (*at == '"') /* what stands in quotes may hold a separator */
                        return -1;
                    at++;
                }
            }
            if (*at++ != (column == columns - 1 ? '\n' : separator))
                return -1;
        }
    }
    return row;
}
