"""Names of the files of an exported policy: a place of their own, so that who runs one loads nothing that writes it."""

C_POLICY, C_POLICY_HEADER, C_EXAMPLE = "policy.c", "policy.h", "example.c"
C_SHIELD, C_SHIELD_HEADER = "shield.c", "shield.h"
ONNX_MODEL, ONNX_EXAMPLE = "policy.onnx", "example.py"
ST_POLICY, ST_XML, ST_EXAMPLE = "policy.st", "policy.xml", "example.st"
