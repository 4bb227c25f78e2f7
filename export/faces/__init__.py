"""Conversion of the published face networks to ONNX, each behind a parity gate."""
