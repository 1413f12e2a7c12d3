/* The bodies of rosplc.st's function blocks, for matiec's output (POUS.h). Generated; changes are lost. */
#include <rosplc/plc.c>

#include <time.h>
#define tm iec_tm /* matiec has a type with this name, which conflicts with that of time.h in C++ */
#include "POUS.h"
#undef tm

#define ROSPLC_PREFIX "{{ prefix }}"
#define ROSPLC_BEAT_MS {{ beat_ms }}u
#include "rosplc_matiec.h"

{% macro get(member, to, from) %}
{% if member.of == "bool" %}
{{ to }} = *({{ from }}) != 0;
{%- elif member.of == "string" %}
rosplc_get_string(&{{ to }}, {{ from }}{{ member.capacity }});
{%- elif member.of == "bytes" %}
memcpy({{ to }}{{ "" if member.count else ".table" }}, {{ from }}{{ member.capacity }} + 1);
{%- elif member.of %}
rosplc_get_{{ member.of }}(&{{ to }}, {{ from }});
{%- else %}
memcpy(&{{ to }}, {{ from }}, sizeof {{ to }});
{%- endif %}
{% endmacro %}
{% macro put(member, to, from) %}
{% if member.of == "string" %}
rosplc_put_string({{ to }}, &{{ from }}{{ member.capacity }});
{%- elif member.of == "bytes" %}
rosplc_put_bytes({{ to }}, {{ from }}{{ "" if member.count else ".table" }}{{ member.capacity }});
{%- elif member.of and member.of != "bool" %}
rosplc_put_{{ member.of }}({{ to }}, &{{ from }});
{%- else %}
memcpy({{ to }}, &{{ from }}, sizeof {{ from }});
{%- endif %}
{% endmacro %}
{% for struct in structs %}
static inline void rosplc_get_{{ struct.name }}({{ struct.name }} *to, const uint8_t *from)
{
{% for member in struct.members %}
{% if member.count %}
    for (unsigned i = 0; i < {{ member.count }}u; i++)
        {{ get(member, "to->" ~ member.name ~ ".table[i]", "from + " ~ member.offset ~ "u + " ~ member.stride ~ "u * i") }}
{% else %}
    {{ get(member, "to->" ~ member.name, "from + " ~ member.offset ~ "u") }}
{% endif %}
{% if member.most %}
    if (to->{{ member.name }} > {{ member.most }}u)
        to->{{ member.name }} = {{ member.most }}u;
{% endif %}
{% else %}
    (void)to;
    (void)from;
{% endfor %}
}

static inline void rosplc_put_{{ struct.name }}(uint8_t *to, const {{ struct.name }} *from)
{
{% for member in struct.members %}
{% if member.count %}
    for (unsigned i = 0; i < {{ member.count }}u; i++)
        {{ put(member, "to + " ~ member.offset ~ "u + " ~ member.stride ~ "u * i", "from->" ~ member.name ~ ".table[i]") }}
{% elif member.most %}
    {
        const UDINT count = from->{{ member.name }} > {{ member.most }}u ? {{ member.most }}u : from->{{ member.name }};
        memcpy(to + {{ member.offset }}u, &count, sizeof count);
    }
{% else %}
    {{ put(member, "to + " ~ member.offset ~ "u", "from->" ~ member.name) }}
{% endif %}
{% else %}
    (void)to;
    (void)from;
{% endfor %}
}

{% endfor %}
{% macro show(values) %}
{% for name, value in values.items() %}
    __SET_VAR(data__->, {{ name }}, , {{ value }});
{% endfor %}
{% endmacro %}
{% macro channel(of) %}
{{ show({
    "XATTACHED": of ~ ".attached != 0",
    "XPEERALIVE": of ~ ".peer_alive != 0",
    "XERROR": of ~ ".error != 0",
    "UDIERROR": of ~ ".error",
    "UDIREENTRIES": of ~ ".reentries",
}) -}}
{% endmacro %}
{% macro found(of) %}
{{ show({"UDIFOUNDLAYOUTLO": of ~ ".found_layout_lo", "UDIFOUNDLAYOUTHI": of ~ ".found_layout_hi"}) -}}
{% endmacro %}
{% macro words(of, names) %}
{% for name in names.split() %}
{{ show({name.replace("_", "") | upper: of ~ "->" ~ name.split("_", 1)[1]}) -}}
{% endfor %}
{% endmacro %}
{% for block in blocks %}
{% set name = block.name | upper %}
{% set layout = layouts[block.dut] %}
void rosplc_call_{{ name }}({{ name }} *data__);
void rosplc_call_{{ name }}({{ name }} *data__)
{
{% if block.direction == "read" %}
    rosplc_own *own = rosplc_own_of(data__, {{ layout.size }}u, rosplc_close_reader);
    const uint32_t now = rosplc_now_ms();
    rosplc_plc_reader *r;
    int got;
    if (!own)
        return;
    r = &own->of.reader;
    if (rosplc_keep(own->name, sizeof own->name, __GET_VAR(data__->STOPIC))) {
        rosplc_plc_reader_init(r, ROSPLC_PREFIX, own->name, {{ '0x%08X' % layout.low }}u, {{ '0x%08X' % layout.high }}u, {{ layout.size }}u, own->record);
        r->channel.beat_ms = ROSPLC_BEAT_MS;
    }
    r->channel.may_open = &rosplc_may_open;
    r->stale_after_ms = rosplc_to_ms(__GET_VAR(data__->TSTALEAFTER));
    r->on_stale = __GET_VAR(data__->UIONSTALE);
    r->in_order = __GET_VAR(data__->XINORDER);
    r->max_per_scan = __GET_VAR(data__->UIMAXPERSCAN);
    r->latched = __GET_VAR(data__->XLATCHED);
    rosplc_before_call(data__, now);
    got = __GET_VAR(data__->XNEXT) ? rosplc_plc_next(r, now) : rosplc_plc_read(r, now);
    rosplc_after_call(data__, now);
    if (got)
        rosplc_get_{{ layout.name }}(&data__->MSG.value, own->record);
{{ channel("r->channel") -}}
{{ found("r->channel") -}}
{{ words("r", "x_valid x_stale x_first x_recovered x_truncated x_substituted udi_sequence udi_lost udi_retries"
    " udi_discontinuities udi_sources x_source_present udi_stamp_lo udi_stamp_hi") -}}
{{ show({
    "XNEW": "__GET_VAR(data__->XNEXT) ? got != 0 : r->is_new != 0",
    "TAGE": "rosplc_of_ms(r->age_ms)",
    "ULISTAMP": "(uint64_t)r->stamp_hi << 32 | r->stamp_lo",
    "UITAKEN": "(uint16_t)r->taken",
}) -}}
{{ "" }}    if (r->stale && r->on_stale == ROSPLC_PLC_SAFE) {
        data__->MSG.value = __GET_VAR(data__->STSAFE);
        __SET_VAR(data__->, XSUBSTITUTED, , 1);
    }
{% else %}
    rosplc_own *own = rosplc_own_of(data__, 1, rosplc_close_writer);
    const uint32_t now = rosplc_now_ms();
    rosplc_plc_writer *w;
    uint8_t *record;
    uint64_t stamp;
    if (!own)
        return;
    w = &own->of.writer;
    if (rosplc_keep(own->name, sizeof own->name, __GET_VAR(data__->STOPIC))) {
        rosplc_plc_writer_init(w, ROSPLC_PREFIX, own->name, {{ '0x%08X' % layout.low }}u, {{ '0x%08X' % layout.high }}u, {{ layout.size }}u);
        w->channel.beat_ms = ROSPLC_BEAT_MS;
    }
    w->channel.may_open = &rosplc_may_open;
    stamp = __GET_VAR(data__->ULISTAMP);
    w->stamp_lo = stamp ? (uint32_t)stamp : __GET_VAR(data__->UDISTAMPLO);
    w->stamp_hi = stamp ? (uint32_t)(stamp >> 32) : __GET_VAR(data__->UDISTAMPHI);
    rosplc_before_call(data__, now);
    record = (uint8_t *)rosplc_plc_write_begin(w, now, __GET_VAR(data__->XENABLE));
    rosplc_after_call(data__, now);
    if (record)
        rosplc_put_{{ layout.name }}(record, &data__->MSG.value);
    rosplc_plc_write_end(w);
{{ channel("w->channel") -}}
{{ found("w->channel") -}}
{{ words("w", "x_ready x_published udi_sequence udi_unsent udi_taken udi_sinks") -}}
{{ show({"UDIPUBLISHED": "w->count", "TTAKEOVER": "rosplc_of_ms(w->takeover_ms)"}) -}}
{% endif %}
}

{% endfor %}
{% for use in uses %}
{% set name = use.name | upper %}
{% set action = use.parts | length == 3 %}
{% set parts = use.parts.values() | list %}
void rosplc_call_{{ name }}({{ name }} *data__);
void rosplc_call_{{ name }}({{ name }} *data__)
{
    rosplc_own *own = rosplc_own_of(data__, {% for dut in parts %}{{ layouts[dut].room }}u{{ " + " if not loop.last }}{% endfor %}, rosplc_close_{{ "client" if use.calls else "server" }});
    const uint32_t now = rosplc_now_ms();
    rosplc_plc_{{ "client *c" if use.calls else "server *s" }};
    int got;
    if (!own)
        return;
{% if use.calls %}
    c = &own->of.client;
    (void)rosplc_keep(own->client, sizeof own->client, __GET_VAR(data__->SCLIENT));
{% else %}
    s = &own->of.server;
{% endif %}
    if (rosplc_keep(own->name, sizeof own->name, __GET_VAR(data__->SNAME))) {
        uint8_t *record = own->record;
{% for dut in parts %}
        own->parts[{{ loop.index0 }}].layout_lo = {{ '0x%08X' % layouts[dut].low }}u;
        own->parts[{{ loop.index0 }}].layout_hi = {{ '0x%08X' % layouts[dut].high }}u;
        own->parts[{{ loop.index0 }}].record_size = {{ layouts[dut].size }}u;
        own->parts[{{ loop.index0 }}].record = record;
        record += {{ layouts[dut].room }}u;
{% endfor %}
{% if use.calls %}
        rosplc_plc_client_init(c, ROSPLC_PREFIX, own->name, own->client, own->parts, {{ action | int }});
        c->block.beat_ms = ROSPLC_BEAT_MS;
    }
    c->block.may_open = &rosplc_may_open;
    c->execute = __GET_VAR(data__->XEXECUTE);
    c->timeout_ms = rosplc_to_ms(__GET_VAR(data__->TTIMEOUT));
    c->grace_ms = rosplc_to_ms(__GET_VAR(data__->TBRIDGEGRACE));
    c->stop = __GET_VAR(data__->{{ "XCANCEL" if action else "XABORT" }});
    rosplc_before_call(data__, now);
    if (rosplc_plc_client_begin(c, now))
        rosplc_put_{{ parts[0] | upper }}((uint8_t *)own->parts[0].record, &data__->{{ "GOAL" if action else "REQUEST" }}.value);
    got = rosplc_plc_client_end(c);
    rosplc_after_call(data__, now);
{{ channel("c->block") -}}
{{ words("c", "x_busy x_done x_aborted e_reason x_server udi_calls udi_late") -}}
{{ show({"XERROR": "c->failed != 0"}) -}}
{% if action %}
{{ words("c", "x_active x_cancel_rejected e_status x_new_feedback") -}}
{{ "" }}    if (got & ROSPLC_PLC_FEEDBACK)
        rosplc_get_{{ parts[2] | upper }}(&data__->FEEDBACK.value, (const uint8_t *)own->parts[2].record);
{% endif %}
    if (got & ROSPLC_PLC_RESPONSE)
        rosplc_get_{{ parts[1] | upper }}(&data__->{{ "RESULT" if action else "RESPONSE" }}.value, (const uint8_t *)own->parts[1].record);
{% else %}
        rosplc_plc_server_init(s, ROSPLC_PREFIX, own->name, own->parts, {{ action | int }});
        s->block.beat_ms = ROSPLC_BEAT_MS;
    }
    s->block.may_open = &rosplc_may_open;
    s->steps = __GET_VAR(data__->XREJECT) ? ROSPLC_PLC_REJECT : 0;
{% if action %}
    s->send_feedback = __GET_VAR(data__->XSENDFEEDBACK);
{% endif %}
{% for step in ("ACCEPT ACCEPT_CANCEL REJECT_CANCEL SUCCEED ABORT CANCELED" if action else "REPLY").split() %}
    s->steps |= __GET_VAR(data__->X{{ step.replace("_", "") }}) ? ROSPLC_PLC_{{ step }} : 0;
{% endfor %}
    rosplc_before_call(data__, now);
    got = rosplc_plc_server_begin(s, now);
    if (got & ROSPLC_PLC_REQUEST)
        rosplc_get_{{ parts[0] | upper }}(&data__->{{ "GOAL" if action else "REQUEST" }}.value, (const uint8_t *)own->parts[0].record);
    if (got & ROSPLC_PLC_RESPONSE)
        rosplc_put_{{ parts[1] | upper }}((uint8_t *)own->parts[1].record, &data__->{{ "RESULT" if action else "RESPONSE" }}.value);
{% if action %}
    if (got & ROSPLC_PLC_FEEDBACK)
        rosplc_put_{{ parts[2] | upper }}((uint8_t *)own->parts[2].record, &data__->FEEDBACK.value);
{% endif %}
    rosplc_plc_server_end(s);
    rosplc_after_call(data__, now);
{{ channel("s->block") -}}
{{ words("s", "x_caller_gone udi_callers udi_calls udi_refused") -}}
{{ show({"TAGE": "rosplc_of_ms(s->age_ms)", "XGOAL" if action else "XREQUEST": "s->request != 0"}) -}}
{% if action %}
{{ words("s", "x_active x_cancel_requested x_canceling x_preempt") -}}
{% endif %}
{% endif %}
}

{% endfor %}
