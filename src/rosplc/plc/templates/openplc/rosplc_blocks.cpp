// The bodies of rosplc.st's function blocks, for STruC++'s output (generated.hpp). Generated; changes are lost.
#include "generated.hpp"

#define ROSPLC_PREFIX "{{ prefix }}"
#define ROSPLC_BEAT_MS {{ beat_ms }}u
#include "rosplc_openplc.hpp"

namespace strucpp {
namespace {

{% for struct in structs %}
void get({{ struct.name }} &to, const uint8_t *from)
{
{% for member in struct.members %}
{% if member.count %}
    for (int i = 0; i < {{ member.count }}; i++)
        get(to.{{ member.name }}[i], from + {{ member.offset }}u + {{ member.stride }}u * static_cast<unsigned>(i){{ member.capacity }});
{% else %}
    get(to.{{ member.name }}, from + {{ member.offset }}u{{ member.capacity }});
{% endif %}
{% if member.most %}
    if (to.{{ member.name }}.get() > {{ member.most }}u)
        to.{{ member.name }} = {{ member.most }}u;
{% endif %}
{% endfor %}
}

void put(uint8_t *to, const {{ struct.name }} &from)
{
{% for member in struct.members %}
{% if member.count %}
    for (int i = 0; i < {{ member.count }}; i++)
        put(to + {{ member.offset }}u + {{ member.stride }}u * static_cast<unsigned>(i), from.{{ member.name }}[i]{{ member.capacity }});
{% elif member.most %}
    put(to + {{ member.offset }}u, IEC_UDINT(from.{{ member.name }}.get() > {{ member.most }}u ? {{ member.most }}u : from.{{ member.name }}.get()));
{% else %}
    put(to + {{ member.offset }}u, from.{{ member.name }}{{ member.capacity }});
{% endif %}
{% endfor %}
}

{% endfor %}
{% for layout in layouts.values() %}
struct of_{{ layout.name }} {
    static constexpr uint32_t LAYOUT_LO = {{ '0x%08X' % layout.low }}u, LAYOUT_HI = {{ '0x%08X' % layout.high }}u, SIZE = {{ layout.size }}u;
    static void take({{ layout.name }} &to, const uint8_t *from) { get(to, from); }
    static void give(uint8_t *to, const {{ layout.name }} &from) { put(to, from); }
};
{% endfor %}

} // namespace

{% for block in blocks %}
{% if block.direction == "read" %}
void rosplc_call({{ block.name | upper }} *block)
{
    rosplc_read<of_{{ block.dut | upper }}>(block, false);
}

bool rosplc_next({{ block.name | upper }} *block)
{
    return rosplc_read<of_{{ block.dut | upper }}>(block, true);
}

{% else %}
void rosplc_call({{ block.name | upper }} *block)
{
    rosplc_write<of_{{ block.dut | upper }}>(block);
}

{% endif %}
{% endfor %}
{% for use in uses %}
void rosplc_call({{ use.name | upper }} *block)
{
    {{ "rosplc_call_server" if use.calls else "rosplc_serve" }}<{% for dut in use.parts.values() %}of_{{ dut | upper }}, {% endfor %}{{ "rosplc_no_feedback, " if use.parts | length == 2 }}{{ use.name | upper }}>(block);
}

{% endfor %}
} // namespace strucpp
