"""The C text of a program, and the tables through which a harness reaches it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from rosplc_st.translator import types as t
from rosplc_st.translator.calls import LIFECYCLE, virtual_methods
from rosplc_st.translator.declarations import Callable_, Declared, FunctionBlock, Program, collect
from rosplc_st.translator.expressions import Expressions
from rosplc_st.translator.initial import init_parameters, instances, set_initial
from rosplc_st.translator.source import parse_texts
from rosplc_st.translator.statements import statements
from rosplc_st.translator.types import Array, Block, String, Struct, Type

__all__ = ["Options", "Translation", "translate"]


@dataclass(frozen=True)
class Options:
    """What the documentation leaves to the target.

    Attributes:
        cpu_bits: Width of intermediate results, and of ``__UXINT`` and handles.
        defined: What ``{IF defined (…)}`` finds, as ``"pou: MemoryBarrier.MemoryBarrier"``.
        bounds: Check every index and every divisor, as CODESYS' CheckBounds functions do.
    """

    cpu_bits: int = 64
    defined: tuple[str, ...] = ()
    bounds: bool = True


@dataclass(frozen=True)
class Translation:
    """The C text and what was declared."""

    code: str
    program: Program
    options: Options


def translate(
    texts: Mapping[str, str],
    options: Options | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Translation:
    """Translate objects, given as texts by their names; ``progress`` as for parse_texts.

    Raises:
        TranslationError: Something is unknown, or CODESYS would refuse it.
    """
    options = options or Options()
    program = collect(parse_texts(texts, options.defined, progress), options.cpu_bits)
    emitter = _Emitter(program, options)
    return Translation(emitter.text(), program, options)


class _Emitter:
    def __init__(self, program: Program, options: Options) -> None:
        self.program, self.options = program, options

    # ---- order and types

    def _depends(self, variables: Iterable[Declared]) -> list[str]:
        def inner(type_: Type) -> list[str]:
            if isinstance(type_, Array):
                return inner(type_.element)
            return [type_.name] if isinstance(type_, (Struct, Block)) else []

        return [name for v in variables if v.kind != "inout" for name in inner(v.type)]

    def _types(self) -> list[str]:
        lines: list[str] = []
        state: dict[str, int] = {}
        every: dict[str, list[Declared]] = {n: d.members for n, d in self.program.duts.items()}
        every |= {n: self.program.members(n) for n in self.program.blocks}

        def visit(name: str, via: Declared | None) -> None:
            if state.get(name) == 2:
                return
            if state.get(name) == 1:
                assert via is not None
                raise via.place.error(f"{name} contains itself")
            state[name] = 1
            for variable in every[name]:
                for other in self._depends([variable]):
                    visit(other, variable)
            state[name] = 2
            if name in self.program.duts:
                pack = self.program.duts[name].pack
                lines.append(f"#pragma pack(push, {pack})")
                lines.append(f"struct D_{name} {{")
                lines.extend(f"    {t.c_declaration(m.type, 'f_' + m.name)};" for m in every[name])
                lines.extend(["};", "#pragma pack(pop)"])
            else:
                lines.append(f"struct B_{name} {{ void *const *vt;")
                lines.extend(f"    {self._member(m)};" for m in every[name])
                lines.append("};")

        for name in every:
            visit(name, None)
        for item in self.program.lists.values():
            lines.append(f"struct G_{item.name} {{ char st_empty;")
            lines.extend(f"    {self._member(m)};" for m in item.variables)
            lines.append("};")
            lines.append(f"static struct G_{item.name} *g_{item.name};")
        for block in self.program.blocks.values():
            if block.is_program:
                lines.append(f"static struct B_{block.name} *p_{block.name};")
        return lines

    @staticmethod
    def _member(declared: Declared) -> str:
        if declared.kind != "inout":
            return t.c_declaration(declared.type, f"f_{declared.name}")
        return t.c_declaration(declared.type, f"(*f_{declared.name})")

    # ---- functions and methods

    @staticmethod
    def _parameter(declared: Declared) -> str:
        name = f"l_{declared.name}"
        if declared.kind == "in":
            if isinstance(declared.type, (Array, Block)):
                raise declared.place.error(f"{declared.name}: an array or block by value")
            if isinstance(declared.type, String):
                return f"const char *a_{declared.name}"
            return t.c_declaration(declared.type, name)
        if isinstance(declared.type, String):
            return f"{'const ' if declared.constant else ''}char *{name}"
        if isinstance(declared.type, Array):
            return t.c_declaration(declared.type, name)
        return t.c_declaration(declared.type, f"*{name}")

    def _signature(self, item: Callable_, name: str, me: bool) -> str:
        parameters = ["void *me"] if me else []
        returns = "void"
        if isinstance(item.returns, String):
            returns = "char *"
            parameters.append("char *st_return")
        elif isinstance(item.returns, (Array, Block)):
            raise item.place.error(f"{item.name} returns an array or block")
        elif item.returns is not None:
            returns = t.c_declaration(item.returns, "")
        parameters += [self._parameter(p) for p in item.parameters]
        return f"{returns} {name}({', '.join(parameters) or 'void'})"

    def _routine(self, item: Callable_, name: str, block: str) -> list[str]:
        e = Expressions(self.program, item.place, item.base_line, block, item, self.options.bounds)
        lines = [f"static {self._signature(item, name, bool(block))}", "{"]
        if block:
            lines.append(f"struct B_{block} *self = me; (void)self;")
        if item.returns is not None and not isinstance(item.returns, String):
            lines.append(f"{t.c_declaration(item.returns, 'st_return')};")
            lines.append("memset(&st_return, 0, sizeof st_return);")
        elif isinstance(item.returns, String):
            lines.append("*st_return = 0;")
        for v in item.variables:
            if v.kind == "in" and isinstance(v.type, String):
                lines.append(f"char l_{v.name}[{v.type.length + 1}] = {{0}};")
                lines.append(f"st_assign(l_{v.name}, {v.type.length}, a_{v.name});")
            if v.kind in ("var", "temp"):
                lines += self._local(v)
        for v in item.variables:
            if v.kind in ("var", "temp"):
                lines += set_initial(e, f"l_{v.name}", v, "0", "0")
            elif v.kind == "out" and v.initial is not None:
                lines += set_initial(e, f"(*l_{v.name})", v, "0", "0")
        if item.abstract and item.body is not None and item.body.statements:
            raise item.place.error(f"{item.name} is ABSTRACT and has a body")
        lines += statements(e, item.body)
        lines.append("goto st_end; st_end:")
        lines.append("return;" if item.returns is None else "return st_return;")
        return [*lines, "}"]

    @staticmethod
    def _local(v: Declared) -> list[str]:
        return [f"{t.c_declaration(v.type, 'l_' + v.name)};", f"memset(&l_{v.name}, 0, sizeof l_{v.name});"]

    # ---- blocks

    def _block(self, block: FunctionBlock) -> list[str]:
        name = block.name
        lines: list[str] = []
        for method in block.methods.values():
            lines += self._routine(method, f"M_{name}_{method.name}", name)
        e = Expressions(self.program, block.place, block.base_line, name, None, self.options.bounds)
        lines += [f"static void R_{name}(void *me)", "{", f"struct B_{name} *self = me; (void)self;"]
        for v in block.variables:
            if v.kind == "temp":
                lines += [*self._local(v), *set_initial(e, f"l_{v.name}", v, "0", "0")]
        lines += [*statements(e, block.body), "goto st_end; st_end: return;", "}"]
        virtual = virtual_methods(e, name)
        entries = []
        for item in virtual:
            found = self.program.method(name, item)
            assert found is not None
            if found.abstract and not block.abstract:
                raise block.place.error(f"{name} leaves {found.owner}.{item} ABSTRACT")
            entries.append(f"(void *)M_{found.owner}_{item}")
        lines.append(f"static void *const vt_{name}[] = {{ {', '.join([*entries, '0'])} }};")
        return lines + self._overrides(block) + self._life(block)

    def _overrides(self, block: FunctionBlock) -> list[str]:
        """Check that what overrides a method has its signature."""
        if not block.base:
            return []
        for method in block.methods.values():
            base = self.program.method(block.base, method.name)
            if base is None or base.access == "PRIVATE" or method.name in LIFECYCLE:
                continue
            ours = [(p.name, p.kind, p.type) for p in method.parameters]
            theirs = [(p.name, p.kind, p.type) for p in base.parameters]
            if ours != theirs or method.returns != base.returns or method.access != base.access:
                raise method.place.error(f"{block.name}.{method.name} differs from what it overrides")
        return []

    def _life(self, block: FunctionBlock) -> list[str]:
        name = block.name
        chain = self.program.ancestry(name)
        parameters = init_parameters(self.program, name)
        e = Expressions(self.program, block.place, block.base_line, name, None, self.options.bounds)
        lines = [
            f"static void values_{name}(struct B_{name} *self, int st_retains, int st_copy)",
            "{",
            "(void)self; (void)st_retains; (void)st_copy;",
        ]
        if block.base:
            lines.append(f"values_{block.base}((void *)self, st_retains, st_copy);")
        for v in block.variables:
            if v.kind not in ("temp", "inout"):
                lines += set_initial(e, f"self->f_{v.name}", v, "st_retains", "st_copy")
        lines.append("}")
        # What is retained keeps its values, but FB_Init of each instance inside it is called.
        lines += [f"static void inits_{name}(struct B_{name} *self, int st_retains, int st_copy)", "{"]
        lines.append("(void)self; (void)st_retains; (void)st_copy;")
        if block.base:
            lines.append(f"inits_{block.base}((void *)self, st_retains, st_copy);")
        for v in block.variables:
            if isinstance(v.type, Block):
                lines += set_initial(e, f"self->f_{v.name}", v, "st_retains", "st_copy")
        lines.append("}")
        signature = ", ".join(
            [f"struct B_{name} *self", "int st_retains", "int st_copy", *map(self._parameter, parameters)]
        )
        lines += [
            f"static void make_{name}({signature})",
            "{",
            f"if (st_kept) inits_{name}(self, st_retains, st_copy);",
            f"else values_{name}(self, st_retains, st_copy);",
            f"self->vt = vt_{name};",
        ]
        for item in chain:
            method = item.methods.get("FB_INIT")
            if method is None:
                continue
            codes = []
            for p in method.parameters:
                if p.name in ("BINITRETAINS", "BINCOPYCODE"):
                    codes.append("st_retains" if p.name == "BINITRETAINS" else "st_copy")
                elif any(p.name == q.name for q in parameters):
                    codes.append(("a_" if isinstance(p.type, String) else "l_") + p.name)
                else:
                    raise method.place.error(f"{name}: nobody gives FB_Init's {p.name}")
            lines.append(f"M_{item.name}_FB_INIT({', '.join(['self', *codes])});")
        lines.append("}")
        for verb, order in (("FB_EXIT", reversed(chain)), ("FB_REINIT", chain)):
            lower = verb[3:].lower()
            argument = ", int st_copy" if verb == "FB_EXIT" else ""
            passed = ", st_copy" if argument else ""
            lines += [
                f"static void {lower}_{name}(struct B_{name} *self{argument})",
                "{",
                "(void)self;" + (" (void)st_copy;" if argument else ""),
            ]
            for item in order:
                if verb in item.methods:
                    if len(item.methods[verb].parameters) != bool(argument):
                        raise item.place.error(f"{verb}'s parameters")
                    lines.append(f"M_{item.name}_{verb}((void *)self{passed});")
            for v in self.program.members(name):
                if v.kind != "inout":
                    lines += self._each(f"self->f_{v.name}", v.type, lower, passed)
            lines.append("}")
        return lines

    def _each(self, path: str, type_: Type, verb: str, passed: str) -> list[str]:
        return [
            f"{' '.join(heads)} {verb}_{block}(&({inner}){passed});"
            for inner, block, heads in instances(self.program, path, type_)
        ]

    # ---- the whole

    def _forward(self) -> list[str]:
        lines = []
        for function in self.program.functions.values():
            lines.append(f"static {self._signature(function, 'F_' + function.name, False)};")
        for block in self.program.blocks.values():
            n = block.name
            lines.append(f"static void R_{n}(void *me);")
            for method in block.methods.values():
                signature = self._signature(method, f"M_{n}_{method.name}", True)
                lines.append(f"static {signature};")
                lines.append(f"typedef {self._signature(method, f'(*T_{n}_{method.name})', True)};")
            parameters = ", ".join(
                [f"struct B_{n} *self", "int", "int", *map(self._parameter, init_parameters(self.program, n))]
            )
            lines.append(f"static void make_{n}({parameters});")
            lines.append(f"static void values_{n}(struct B_{n} *self, int, int);")
            lines.append(f"static void inits_{n}(struct B_{n} *self, int, int);")
            lines.append(f"static void exit_{n}(struct B_{n} *self, int);")
            lines.append(f"static void reinit_{n}(struct B_{n} *self);")
        return lines

    def _globals(self) -> list[str]:
        lines: list[str] = []
        holders: list[tuple[str, str, bool]] = []
        ordered = sorted(self.program.lists.values(), key=lambda g: not all(v.constant for v in g.variables))
        for item in ordered:
            name = f"G_{item.name}"
            e = Expressions(self.program, item.place, 1, "", None, self.options.bounds)
            lines += [
                f"static void make_{name}(struct {name} *self, int st_retains, int st_copy)",
                "{",
                "(void)self; (void)st_retains; (void)st_copy;",
            ]
            for v in item.variables:
                lines += set_initial(e, f"self->f_{v.name}", v, "st_retains", "st_copy")
            lines.append("}")
            for verb, argument, passed in (("exit", ", int st_copy", ", st_copy"), ("reinit", "", "")):
                lines += [
                    f"static void {verb}_{name}(struct {name} *self{argument})",
                    "{",
                    "(void)self;" + (" (void)st_copy;" if argument else ""),
                ]
                for v in item.variables:
                    lines += self._each(f"self->f_{v.name}", v.type, verb, passed)
                lines.append("}")
            holders.append((name, f"g_{item.name}", all(v.constant for v in item.variables)))
        for block in self.program.blocks.values():
            if block.is_program:
                holders.append((f"B_{block.name}", f"p_{block.name}", False))
        retained = {f"G_{item.name}" for item in ordered if item.retained}
        for name, pointer, _ in holders:
            maker = name if name.startswith("G_") else name[2:]
            lines += [f"static void *create_{pointer}(int st_retains, int st_copy)", "{"]
            lines += [f"struct {name} *self = st_memory(sizeof *self);", f"if (!{pointer}) {pointer} = self;"]
            lines += [f"make_{maker}(self, st_retains, st_copy);", "return self;", "}"]
        lines += ["void st_start(void)", "{"]
        lines += [f"{pointer} = 0; {pointer} = create_{pointer}(1, 0);" for _, pointer, _ in holders]
        lines += ["}", "void st_stop(void)", "{"]
        for name, pointer, _ in holders:
            maker = name if name.startswith("G_") else name[2:]
            lines.append(f"exit_{maker}({pointer}, 0);")
        # A warm start: retained lists keep their values, and their instances are told so by FB_Init.
        lines += ["}", "void st_warm_start(void)", "{"]
        for name, pointer, constant in holders:
            if name in retained:
                lines.append(f"st_kept = 1; make_{name}({pointer}, 0, 0); st_kept = 0;")
            elif not constant:
                lines.append(f"{pointer} = 0; {pointer} = create_{pointer}(0, 0);")
        lines += ["}", "void st_online_change(void)", "{"]
        for name, pointer, constant in holders:
            if constant:
                continue
            maker = name if name.startswith("G_") else name[2:]
            lines += ["{", f"struct {name} *st_old = {pointer}, *st_new;", f"exit_{maker}(st_old, 1);"]
            lines += [f"st_new = create_{pointer}(0, 1);", "memcpy(st_new, st_old, sizeof *st_new);"]
            lines += [
                f"{pointer} = st_new; st_poison(st_old, sizeof *st_old);",
                f"reinit_{maker}(st_new);",
                "}",
            ]
        lines.append("}")
        lines.append("const struct st_global st_globals[] = {")
        for _name, pointer, _ in holders:
            lines.append(f'    {{ "{pointer[2:]}", (void **)&{pointer}, sizeof *{pointer} }},')
        lines += ["    { 0, 0, 0 } };", "const struct st_program st_programs[] = {"]
        for block in self.program.blocks.values():
            if block.is_program:
                lines.append(f'    {{ "{block.name}", R_{block.name}, (void **)&p_{block.name} }},')
        lines += ["    { 0, 0, 0 } };", "const struct st_member st_members[] = {"]
        for name, members in self._owners():
            lines.append(f'    {{ "{name[2:]}", "", 0, sizeof(struct {name}) }},')
            for m in members:
                if m.kind != "inout":
                    where = f"struct {name}, f_{m.name}"
                    size = f"sizeof(((struct {name} *)0)->f_{m.name})"
                    lines.append(f'    {{ "{name[2:]}", "{m.name}", offsetof({where}), {size} }},')
        lines.append("    { 0, 0, 0, 0 } };")
        return lines

    def _owners(self) -> list[tuple[str, list[Declared]]]:
        owners = [(f"D_{n}", d.members) for n, d in self.program.duts.items()]
        owners += [(f"B_{n}", self.program.members(n)) for n in self.program.blocks]
        return owners + [(f"G_{n}", g.variables) for n, g in self.program.lists.items()]

    def text(self) -> str:
        """Return the whole C text."""
        width = f"const size_t st_uxint_size = {self.program.cpu_bits // 8};"
        lines = ['#include "st_runtime.h"', width, "static int st_kept;", *self._types(), *self._forward()]
        for function in self.program.functions.values():
            lines += self._routine(function, f"F_{function.name}", "")
        for block in self.program.blocks.values():
            lines += self._block(block)
        return "\n".join([*lines, *self._globals()]) + "\n"
