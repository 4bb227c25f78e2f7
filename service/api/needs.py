"""What routes ask the application for: who is asking, and what there is."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends

from service.api.context import Context, context_of, tenant_of
from service.api.keys import Tenant

Asking = Annotated[Tenant, Depends(tenant_of)]
Here = Annotated[Context, Depends(context_of)]
