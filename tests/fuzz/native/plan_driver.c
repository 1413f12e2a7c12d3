/* Runs every plan of a file over valid, truncated, mutated and random input, in exact-size memory.
 *
 * usage: plan_driver PLANS ROUNDS. Build it with -fsanitize=address,undefined, or for another machine;
 * it prints the number of checks and a digest that is the same on every machine. */
#include "plan_checks.h"

static uint64_t state = 88172645463325252u;

static uint32_t draw(uint32_t below) /* xorshift: the same everywhere */
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)((state >> 16) % below);
}

static void mutate(uint8_t *data, size_t size)
{
    static const uint32_t words[] = {0, 1, 2, 3, 16, 17, 255, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF};
    for (uint32_t times = 1 + draw(4); size && times; times--) {
        size_t at = draw((uint32_t)size);
        if (draw(2) || size < 4 || (at &= ~(size_t)3) > size - 4)
            data[at] = (uint8_t)draw(256);
        else
            memcpy(data + at, &words[draw(sizeof words / sizeof *words)], 4);
    }
}

int main(int argc, char **argv)
{
    uint32_t count, rounds, checks = 0;
    plan_case *cases;
    if (argc != 3)
        return 2;
    cases = read_plans(argv[1], &count);
    rounds = (uint32_t)atoi(argv[2]);
    for (uint32_t i = 0; i < count; i++) {
        plan_case *one = &cases[i];
        uint32_t record_size = one->plan.record_size;
        uint8_t *record = exact(record_size);
        for (uint32_t k = 0; k < one->messages; k++) {
            blob whole = one->message[k];
            uint8_t *copy = exact(whole.size);
            /* At most 3 bytes of padding may be missing from a CDR message. */
            size_t needed = whole.size;
            if (check_wire(&one->plan, whole.data, whole.size, 0))
                stop("a valid message is refused");
            while (needed && one->plan.wire == RP_CDR && whole.size - needed < 3 &&
                   !check_wire(&one->plan, whole.data, needed - 1, 0))
                needed--;
            for (size_t size = 0; size < needed; size++, checks++)
                if (check_wire(&one->plan, whole.data, size, (int)(size & 1)) != 1)
                    stop("a truncated message is not refused as such");
            for (uint32_t round = 0; round < rounds; round++, checks++) {
                if (whole.size)
                    memcpy(copy, whole.data, whole.size);
                mutate(copy, whole.size);
                check_wire(&one->plan, copy, whole.size, (int)(round & 1));
            }
            release(copy, whole.size);
        }
        for (uint32_t round = 0; round < rounds; round++, checks++) {
            uint32_t kind = draw(3);
            size_t used;
            for (uint32_t at = 0; at < record_size; at++)
                record[at] = (uint8_t)(kind == 0 ? draw(256) : kind == 1 ? draw(3) : draw(8) ? 'a' : 0);
            used = check_record(&one->plan, record);
            /* A destination that is too small is refused, and nothing is written behind it. */
            size_t room = draw((uint32_t)used + 1);
            uint8_t *out = exact(room);
            rp_fault fault;
            if (!rp_encode(&one->plan, record, out, room, &used, &fault) ? used > room : fault.code != 9)
                stop("a destination that is too small is not refused");
            release(out, room);
        }
        for (uint32_t round = 0; round < rounds; round++, checks++) {
            uint8_t *copy = exact(one->source.size);
            blob input = one->messages ? one->message[draw(one->messages)] : one->source;
            memcpy(copy, one->source.data, one->source.size);
            mutate(copy, one->source.size);
            check_blob(copy, one->source.size, input.data, input.size);
            release(copy, one->source.size);
        }
        release(record, record_size);
    }
    free_plans(cases, count);
    printf("%u plans, %u checks, digest %016llx\n", (unsigned)count, (unsigned)checks, (unsigned long long)digest);
    return 0;
}
