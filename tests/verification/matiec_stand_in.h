/* Stands in for matiec's headers where matiec is not installed: its conventions as far as generated blocks use them. A
 * variable of a block has a value and flags; names are in capitals; a string holds 126 bytes, whatever is declared. */
#ifndef MATIEC_STAND_IN_H
#define MATIEC_STAND_IN_H
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
#define EXTERN extern "C"
#else
#define EXTERN extern
#endif
#define STR_MAX_LEN 126
#define TRUE 1
#define FALSE 0
#define __IEC_FORCE_FLAG 2
#define __GET_VAR(name, ...) name.value __VA_ARGS__
#define __SET_VAR(prefix, name, suffix, given) \
    if (!(prefix name.flags & __IEC_FORCE_FLAG)) prefix name.value suffix = given
#define DECLARE(type) \
    typedef struct { \
        type value; \
        uint8_t flags; \
    } __IEC_##type##_t;
#define NAMED(type, c) \
    typedef c type; \
    DECLARE(type)

typedef int8_t __strlen_t;
typedef struct {
    __strlen_t len;
    uint8_t body[STR_MAX_LEN];
} STRING;
typedef struct {
    long int tv_sec, tv_nsec;
} TIME;
typedef struct {
    int tm_day;
} tm; /* matiec's own, beside that of time.h */
NAMED(BOOL, uint8_t)
NAMED(BYTE, uint8_t)
NAMED(SINT, int8_t)
NAMED(USINT, uint8_t)
NAMED(INT, int16_t)
NAMED(UINT, uint16_t)
NAMED(DINT, int32_t)
NAMED(UDINT, uint32_t)
NAMED(LINT, int64_t)
NAMED(ULINT, uint64_t)
NAMED(REAL, float)
NAMED(LREAL, double)
DECLARE(STRING)
DECLARE(TIME)

static inline STRING text(const char *from)
{
    STRING made;
    memset(&made, 0, sizeof made);
    made.len = (__strlen_t)strlen(from);
    memcpy(made.body, from, (size_t)made.len);
    return made;
}

static inline TIME hours(long count)
{
    TIME made;
    made.tv_sec = count * 3600;
    made.tv_nsec = 0;
    return made;
}
#endif
