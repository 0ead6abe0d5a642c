"""Declarations in Structured Text as XML of PLCopen TC6, version 2.01, which development systems import."""

import re
from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from nnql_bullet.exports.st_source import Unit

NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
_XHTML = "http://www.w3.org/1999/xhtml"
_SECTIONS = {
    "VAR": "localVars",
    "VAR CONSTANT": "localVars",
    "VAR_INPUT": "inputVars",
    "VAR_OUTPUT": "outputVars",
    "VAR_IN_OUT": "inOutVars",
}
_ELEMENTARY = ("REAL", "LREAL", "DINT", "BOOL")
_ARRAY = re.compile(r"ARRAY \[(\d+)\.\.(\d+)\] OF (\w+)")
_DECLARED = re.compile(r"^(VAR(?:_\w+)?(?: CONSTANT)?)\s+(.*?)END_VAR\n", re.S | re.M)


def plcopen_xml(units: Sequence[Unit], name: str, version: str) -> str:
    """A project of declarations.

    Args:
        units: The declarations.
        name: Of the project.
        version: Of this program.
    """
    project = Element("project", xmlns=NAMESPACE)
    always = "1970-01-01T00:00:00"  # the same policy gives the same file
    SubElement(
        project,
        "fileHeader",
        companyName="nnql-bullet",
        productName="nnql-bullet",
        productVersion=version,
        creationDateTime=always,
    )
    content = SubElement(project, "contentHeader", name=name)
    info = SubElement(content, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        SubElement(SubElement(info, language), "scaling", x="1", y="1")
    types = SubElement(project, "types")
    data_types, pous = SubElement(types, "dataTypes"), SubElement(types, "pous")
    for unit in units:
        if unit.kind == "type":
            _data_type(data_types, unit)
        else:
            _pou(pous, unit)
    SubElement(SubElement(project, "instances"), "configurations")
    ElementTree.indent(project, " ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(project, encoding="unicode") + "\n"


def _data_type(parent: Element, unit: Unit) -> None:
    base = SubElement(SubElement(parent, "dataType", name=unit.name), "baseType")
    array = _ARRAY.search(unit.text)
    if "STRUCT" not in unit.text and array:
        _type(base, array[0])
        return
    struct = SubElement(base, "struct")
    for member, kind in re.findall(r"^ {8}(\w+) : (\w+);", unit.text, re.M):
        _type(SubElement(SubElement(struct, "variable", name=member), "type"), kind)


def _type(parent: Element, kind: str) -> None:
    array = _ARRAY.fullmatch(kind)
    if array:
        its = SubElement(parent, "array")
        SubElement(its, "dimension", lower=array[1], upper=array[2])
        _type(SubElement(its, "baseType"), array[3])
    elif kind in _ELEMENTARY:
        SubElement(parent, kind)
    else:
        SubElement(parent, "derived", name=kind)


def _pou(parent: Element, unit: Unit) -> None:
    pou = SubElement(parent, "pou", name=unit.name, pouType="function" if unit.kind == "function" else "functionBlock")
    interface = SubElement(pou, "interface")
    result = re.search(rf"^FUNCTION {unit.name} : (\w+)", unit.text, re.M)
    if result:
        _type(SubElement(interface, "returnType"), result[1])
    for section, declarations in _DECLARED.findall(unit.text):
        variables = SubElement(interface, _SECTIONS[section])
        if section == "VAR CONSTANT":
            variables.set("constant", "true")
        for declaration in declarations.split(";")[:-1]:
            name, kind, value = re.findall(r"^\s*(\w+) : (.*?)(?: := \[(.*)\])?$", declaration, re.S)[0]
            variable = SubElement(variables, "variable", name=name)
            _type(SubElement(variable, "type"), kind)
            if value:
                values = SubElement(SubElement(variable, "initialValue"), "arrayValue")
                for one in value.split(", "):
                    SubElement(SubElement(values, "value"), "simpleValue", value=one)
    ends = [its.end() for its in re.finditer(r"^FUNCTION.*\n", unit.text, re.M)]
    ends += [its.end() for its in _DECLARED.finditer(unit.text)]
    body = unit.text[max(ends) :].rsplit("END_FUNCTION", 1)[0]
    text = SubElement(SubElement(SubElement(pou, "body"), "ST"), "xhtml", xmlns=_XHTML)
    text.text = body
